"""Random damages to the bytes of a file: flipped, cut, doubled, overwritten, other numbers."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable

import numpy as np

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
EXTREME_NUMBERS = (
    *(b"0", b"-0.0", b"-1", b"1e308", b"-1e308", b"1e999", b"1e-320", b"nan", b"inf", b"-inf"),
    *(b"", b"x", b"1e5", b"4294967296", b"-9223372036854775809", b"9" * 400, b"true", b"0x10"),
)
EXTREME_BYTES = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x01")
TOKENS = (
    *(b"\n", b"\r", b",", b";", b'"', b"'", b"(", b")", b"[", b"]", b"{", b"}", b"#", b"\t", b"\0"),
    *(b"\xff\xfe", b"\xed\xa0\x80", b"\\ud800", b"\xe2\x80\xae", b"\x1b[31m", b"null", b"../x"),
    *(b"/dev/zero", b"&a [*a]", b"!!python/object:os.system", b"=", b":", b"NaN", b"EMPTY"),
)

Damage = Callable[[bytes, np.random.Generator], bytes]


def place(content: bytes, generator: np.random.Generator) -> int:
    """Anywhere in the content, more often near its beginning, where headers are."""
    end = len(content) if generator.random() < 0.7 else min(len(content), 256)
    return int(generator.integers(end + 1))


def length(generator: np.random.Generator) -> int:
    """Mostly a few bytes, sometimes a thousand."""
    return int(2.0 ** generator.uniform(0.0, 10.0))


def flipped(content: bytes, generator: np.random.Generator) -> bytes:
    """Up to eight bits the other way round."""
    changed = bytearray(content)
    for _ in range(int(generator.integers(1, 9))):
        changed[min(place(content, generator), len(changed) - 1)] ^= 1 << int(generator.integers(8))
    return bytes(changed)


def cut_off(content: bytes, generator: np.random.Generator) -> bytes:
    """Only the beginning."""
    return content[: place(content, generator)]


def without_piece(content: bytes, generator: np.random.Generator) -> bytes:
    """A piece left out."""
    start = place(content, generator)
    return content[:start] + content[start + length(generator) :]


def doubled_piece(content: bytes, generator: np.random.Generator) -> bytes:
    """A piece twice, the second time anywhere."""
    start, other = place(content, generator), place(content, generator)
    return content[:other] + content[start : start + length(generator)] + content[other:]


def overwritten(content: bytes, generator: np.random.Generator) -> bytes:
    """A piece of random bytes, or of an extreme one."""
    start, count = place(content, generator), min(length(generator), len(content))
    piece = (
        generator.bytes(count)
        if generator.random() < 0.5
        else EXTREME_BYTES[int(generator.integers(len(EXTREME_BYTES)))] * min(count, 16)
    )
    return content[:start] + piece + content[start + len(piece) :]


def inserted(content: bytes, generator: np.random.Generator) -> bytes:
    """A token that means something in one format or another."""
    start = place(content, generator)
    return content[:start] + TOKENS[int(generator.integers(len(TOKENS)))] + content[start:]


def other_number(content: bytes, generator: np.random.Generator) -> bytes:
    """A number in the text replaced by an extreme one, or by none."""
    found = list(NUMBER.finditer(content))
    if not found:
        return inserted(content, generator)
    start, end = found[int(generator.integers(len(found)))].span()
    other = EXTREME_NUMBERS[int(generator.integers(len(EXTREME_NUMBERS)))]
    return content[:start] + other + content[end:]


def other_digit(content: bytes, generator: np.random.Generator) -> bytes:
    """A digit of a number replaced by another: what is left can mostly be read."""
    found = [at for at, byte in enumerate(content) if 48 <= byte < 58]
    if not found:
        return flipped(content, generator)
    at = found[int(generator.integers(len(found)))]
    return content[:at] + str(int(generator.integers(10))).encode() + content[at + 1 :]


def other_order(content: bytes, generator: np.random.Generator) -> bytes:
    """Two lines exchanged."""
    lines = content.splitlines(keepends=True)
    first, second = generator.integers(len(lines), size=2)
    lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


DAMAGES: tuple[Damage, ...] = (
    *(flipped, cut_off, without_piece, doubled_piece, overwritten, inserted),
    *(other_number, other_digit, other_order),
)


def damaged(content: bytes, generator: np.random.Generator) -> bytes:
    """Return `content` with one to three damages.

    Half of the zip archives are damaged in one of their members and packed again, as otherwise
    hardly any damage passes the checksums.
    """
    if content.startswith(b"PK") and generator.random() < 0.5:
        return _repacked(content, generator)
    for _ in range(min(int(generator.geometric(0.6)), 3)):
        if content:
            content = DAMAGES[int(generator.integers(len(DAMAGES)))](content, generator)
    return content


def _repacked(content: bytes, generator: np.random.Generator) -> bytes:
    members: list[tuple[str, bytes]] = []
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    chosen = int(generator.integers(len(members)))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for index, (name, member) in enumerate(members):
            archive.writestr(name, damaged(member, generator) if index == chosen else member)
    return packed.getvalue()
