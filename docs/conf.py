"""Sphinx configuration: ``sphinx-build -W docs out/site``.

The docstrings are plain text with code in backquotes, not reStructuredText.
"""

import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from latex2mathml.converter import convert

sys.path.insert(0, str(Path(__file__).parents[1]))

from jaxgel.cli.parser import parser as command_line

project = "jaxgel"
author = copyright = "The jaxgel developers"  # noqa: A001
release = version = version_of("jaxgel")
extensions = ["myst_nb", "sphinx.ext.autodoc"]
nb_execution_mode = "off"  # notebooks/execute.py has executed them
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "deflist", "fieldlist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "jaxgel"
html_static_path, html_css_files = ["_static"], ["site.css"]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"}
}
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "exclude-members": "shapes, positive"}
suppress_warnings = ["ref.python"]  # fields of the same name


def _copy_notebooks():
    """Copy the notebooks to docs/tutorials, with links to pages as seen from there."""
    for file in (Path(__file__).parents[1] / "notebooks").glob("*.ipynb"):
        copy, text = (
            Path(__file__).parent / "tutorials" / file.name,
            file.read_text(encoding="utf-8").replace("](../docs/", "](../"),
        )
        copy.parent.mkdir(exist_ok=True)
        if not copy.exists() or copy.read_text(encoding="utf-8") != text:
            copy.write_text(text, encoding="utf-8")


_copy_notebooks()


class CommandHelp(Directive):
    """The help of every command, as it is printed."""

    def run(self):
        """One section per command."""
        parser, commands = command_line()
        sections = []
        for name, command in [("jaxgel", parser), *commands.items()]:
            title = name if name == "jaxgel" else f"jaxgel {name}"
            section = nodes.section(ids=[nodes.make_id(title)])
            section += nodes.title(title, title)
            section += nodes.literal_block(
                command.format_help(), command.format_help(), language="none"
            )
            sections.append(section)
        return sections


def _plain(_app, _what, _name, _object, _options, lines):
    """Make reStructuredText of a docstring: tables stay, no prose becomes markup by accident.

    Tables are what is indented.
    """
    done = []
    for line in lines:
        indented, goes_on = (
            line.startswith("    "),
            bool(done) and (done[-1].startswith("    ") or done[-1].strip() != ""),
        )
        if indented and not goes_on:
            done += ["::", ""]
        if not indented and not line.startswith((">>>", "...")):
            parts = re.split(r"(``.*?``|`[^`]*`)", line)
            parts[::2] = [re.sub(r"([*|_`])", r"\\\1", part) for part in parts[::2]]
            parts[1::2] = [part + "\\ " for part in parts[1::2]]  # a letter may follow
            line = "".join(parts)
        done.append(line)
    lines[:] = done


def _formula(self, node):
    """MathML, which browsers draw themselves: the pages need no script and no network."""
    block = isinstance(node, nodes.math_block)
    self.body.append(convert(node.astext(), display="block" if block else "inline"))
    raise nodes.SkipNode


def setup(app):
    """Register these."""
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.add_directive("command-help", CommandHelp)
    app.connect("autodoc-process-docstring", _plain)
