"""JAX's 64-bit numbers, switched on without importing JAX.

Contract: after `always_on`, JAX makes float64 numbers in this process. Where JAX is imported already, it is switched at once; otherwise at
the end of its own import, whoever asks for it, before any other code sees it. A search that imports nothing, such as
``importlib.util.find_spec("jax")``, changes nothing.
"""

import importlib.abc
import sys


def always_on() -> None:
    """Switch JAX to 64-bit numbers now, or as soon as it is imported."""
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        sys.meta_path.insert(0, _Finder())


class _Finder(importlib.abc.MetaPathFinder):
    """Finds JAX where the other finders do, and has its import end with the switch."""

    def find_spec(self, name, path=None, target=None):
        if name != "jax":
            return None
        specs = (finder.find_spec(name, path, target) for finder in sys.meta_path if finder is not self and hasattr(finder, "find_spec"))
        spec = next((found for found in specs if found is not None), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def with_float64(module):
                execute(module)
                module.config.update("jax_enable_x64", True)
                if self in sys.meta_path:
                    sys.meta_path.remove(self)

            spec.loader.exec_module = with_float64
        return spec
