"""How kernels that call kernels of other files are compiled: anew for a change of any of these files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from valve.kernel.compiled import kernel


def kernel_of(*sources: str | Path) -> Callable[[Callable[..., Any]], Any]:
    """Return the decorator ``kernel`` for functions that are made of these files, paths, beside ``valve.kernel``.

    numba keeps what it compiled until the function's own file changes. So the name that it is kept under holds a
    digest of all files, a change of any of which is to compile it anew.
    """
    content = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources))
    digest = content.hexdigest()[:8]

    def compiled(function: Callable[..., Any]) -> Any:
        function.__qualname__ = f"{function.__qualname__}_{digest}"
        return kernel(function)

    return compiled
