"""How the simulator's kernels are compiled: as valve.kernel's, once for a change of any of theirs or of these."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from valve.kernel import compiled

_SOURCES: Final = compiled.digest(Path(compiled.__file__).parent, Path(__file__).parent)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for flat numbers and arrays, as ``valve.kernel.compiled.kernel`` does."""
    return compiled.kernel(function, _SOURCES)
