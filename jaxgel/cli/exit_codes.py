"""Exit codes of the command line.

0 done; 2 unusable input, with one line that names it; 3 the sweep stopped early; 130 interrupted; 141 when the reader of the output closes
the pipe, as ``| head`` does.
"""

DONE, UNUSABLE, STOPPED, INTERRUPTED, UNREAD = 0, 2, 3, 130, 141
