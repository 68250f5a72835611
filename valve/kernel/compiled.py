"""How the kernels are compiled: once for a change of any of them.

numba keeps what it compiled and renews it when the function's own file changes, not when one does that it calls. So
the name that a kernel is kept under holds a digest of all kernels' sources.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from numba import njit


def digest(*folders: Path) -> str:
    """Eight hexadecimal digits of the sources of these folders."""
    sources = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.glob("*.py")):
            sources.update(path.read_bytes())
    return sources.hexdigest()[:8]


_SOURCES: Final = digest(Path(__file__).parent)


def kernel(function: Callable[..., Any], sources: str = _SOURCES) -> Any:
    """Compile a function for flat numbers and arrays; numba types it from its arguments.

    A division by zero gives inf or NaN, as in numpy. Use it for what calls one of these kernels too; kernels of another
    folder give the ``sources`` digest of both.
    """
    function.__qualname__ = f"{function.__qualname__}_{sources}"
    return njit(cache=True, error_model="numpy")(function)
