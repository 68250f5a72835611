"""What is compiled is kept under a name that changes with any kernel's source."""

from __future__ import annotations

from pathlib import Path

from valve.kernel import compiled
from valve.kernel.compiled import kernel


def test_a_kernel_is_kept_under_another_name_where_any_source_changes(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("A = 1\n")
    (tmp_path / "other.py").write_text("B = 1\n")
    before = compiled.digest(tmp_path)
    assert compiled.digest(tmp_path) == before
    (tmp_path / "other.py").write_text("B = 2\n")
    assert compiled.digest(tmp_path) != before


def test_a_kernels_cache_file_bears_the_sources_digest() -> None:
    def halved(x: float) -> float:
        return 0.5 * x

    compiled_function = kernel(halved)
    assert compiled_function(3.0) == 1.5
    assert compiled.digest(Path(compiled.__file__).parent) in compiled_function.__qualname__


def test_a_division_by_zero_is_infinite_and_raises_nothing() -> None:
    def inverse(x: float) -> float:
        return 1.0 / x

    assert kernel(inverse)(0.0) == float("inf")
