"""The content of a file: taken out of a gz or a zip, within bounds, and decoded where it is text."""

from __future__ import annotations

import codecs
import gzip
import io
import zipfile
import zlib
from typing import Final

from valve.errors import RecordingError

_MOST_BYTES: Final = 2**29  # unpacked: 4 hours of 1 kHz
_BYTES_A_ROW: Final = 256
_ENCODING_SAMPLE: Final = 2**18
# Where bytes are no UTF-8, these write a German, French, Polish or Russian header; the first that fits is taken.
_ENCODINGS: Final = ("cp1252", "latin_1", "cp1250", "cp1251", "cp437", "cp850", "mac_roman", "shift_jis", "gb18030")
_BOMS: Final = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
ZIP: Final = b"PK\x03\x04"
_WORKBOOK: Final = "[Content_Types].xml"  # what makes a zip an xlsx
_MOST_NAMED: Final = 5  # files of a zip in a message
_TEXT_HEAD: Final = 256  # bytes that show whether it is UTF-16


def plain(data: bytes, most_bytes: int, source: str) -> tuple[bytes, str]:
    """Return what a gz, a zip of one file, or one in the other holds, and what it was packed as: "gz of ", or "".

    Raises RecordingError where it cannot be unpacked, is too large, or is a zip of several files.
    """
    packed = ""
    if data.startswith(b"\x1f\x8b"):
        data, packed = _unpacked(data, most_bytes, source), "gz of "
    if data.startswith(ZIP) and (name := _only_file(data, most_bytes, source)) is not None:
        data, packed = _unzipped(data, name, most_bytes, source), f"{packed}zip of "
    return data, packed


def text_of(data: bytes, source: str) -> tuple[str, str]:
    """Return the text of a file and its encoding, without the room that a logger kept for rows when it was cut off."""
    if data.endswith(b"\0\0") and b"\0" not in data[:_TEXT_HEAD]:
        data = data.rstrip(b"\0")
    return decoded(data, source)


def bytes_of_rows(most_rows: int) -> int:
    """Return how many bytes so many rows may have, with what a workbook has beside them."""
    return min(_MOST_BYTES, 2**20 + _BYTES_A_ROW * most_rows)


def _unpacked(data: bytes, most_bytes: int, source: str) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            unpacked = file.read(most_bytes + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise RecordingError(f"{source}: its gz cannot be unpacked ({error}): pack it again") from None
    require_size(len(unpacked), most_bytes, source)
    return unpacked


def _only_file(data: bytes, most_bytes: int, source: str) -> str | None:
    """Return the one file of a zip; None for a workbook, and for what only looks like a zip."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [one for one in archive.infolist() if not one.is_dir() and not _is_litter(one.filename)]
    except (zipfile.BadZipFile, OSError, ValueError):
        return None
    if any(one.filename == _WORKBOOK for one in entries):
        return None
    if len(entries) != 1:
        names = ", ".join(repr(one.filename) for one in entries[:_MOST_NAMED]) or "none"
        raise RecordingError(f"{source}: it is a zip of {len(entries)} files ({names}): give one of them alone")
    require_size(entries[0].file_size, most_bytes, source)
    return entries[0].filename


def _is_litter(name: str) -> bool:
    """Whether a file of a zip is what a desktop put beside the others."""
    return name.startswith("__MACOSX/") or name.rpartition("/")[2] in (".DS_Store", "Thumbs.db")


def _unzipped(data: bytes, name: str, most_bytes: int, source: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, archive.open(name) as file:
            unpacked = file.read(most_bytes + 1)
    except (zipfile.BadZipFile, OSError, EOFError, KeyError, ValueError, RuntimeError, zlib.error) as error:
        raise RecordingError(
            f"{source}: its zip cannot be unpacked ({error}): pack it again, without a password"
        ) from None
    require_size(len(unpacked), most_bytes, source)
    return unpacked


def require_size(size: int, most_bytes: int, source: str) -> None:
    """Raise RecordingError where a file would be larger than that once it is unpacked."""
    if size > most_bytes:
        raise RecordingError(f"{source}: unpacked it has more than {most_bytes} bytes: cut it into parts")


def decoded(data: bytes, source: str) -> tuple[str, str]:
    """Return the text and its encoding's name. Raises RecordingError where it is no text."""
    for bom, encoding in _BOMS:
        if data.startswith(bom):
            return _strictly(data[len(bom) :] if encoding == "utf-8" else data, encoding, source), f"{encoding} (BOM)"
    head = data[:4096]
    if b"\0" in head:
        odd, even = head[1::2].count(0), head[0::2].count(0)
        if max(odd, even) < 0.3 * len(head[1::2]) or min(odd, even) > 0.05 * len(head):
            raise RecordingError(f"{source}: it is no text: give a CSV, xlsx or Parquet file")
        encoding = "utf-16-le" if odd > even else "utf-16-be"
        return _strictly(data, encoding, source), encoding
    try:
        return data.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        encoding = _guessed_encoding(data, source)
        return data.decode(encoding, errors="replace"), encoding


def _strictly(data: bytes, encoding: str, source: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise RecordingError(f"{source}: it begins as {encoding} and is not ({error.reason}): save it again") from None


def _guessed_encoding(data: bytes, source: str) -> str:
    from charset_normalizer import from_bytes  # noqa: PLC0415  - few files need it

    # Only lines with a letter beyond ASCII tell encodings apart, and numbers are no language.
    telling = [line for line in data[:_ENCODING_SAMPLE].splitlines() if not line.isascii()][:200] or [data[:4096]]
    best = from_bytes(b"\n".join(telling), cp_isolation=list(_ENCODINGS)).best()
    if best is None:
        raise RecordingError(f"{source}: it is no text in any encoding that is known: save it as UTF-8")
    # Western Europe first: it writes every unit, and the short text of a header fits others as well.
    for encoding in (*_ENCODINGS[:1], best.encoding):
        text = b"\n".join(telling).decode(encoding, errors="replace")
        strange = [letter for letter in text if ord(letter) > 127 and not letter.isalpha() and letter not in "°µ²³–—"]
        if not strange:
            return encoding
    return best.encoding
