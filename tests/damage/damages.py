"""Random damages to the bytes of a file: flipped, cut, doubled, overwritten, other numbers."""

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


def _place(content: bytes, generator: np.random.Generator) -> int:
    """Return a place in the content, more often near its beginning, where headers are."""
    end = len(content) if generator.random() < 0.7 else min(len(content), 256)
    return int(generator.integers(end + 1))


def _replaced(content: bytes, start: int, removed: int, piece: bytes) -> bytes:
    return content[:start] + piece + content[start + removed :]


def _flip_bits(content: bytes, generator: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(int(generator.integers(1, 9))):
        at = min(_place(content, generator), len(changed) - 1)
        changed[at] ^= 1 << int(generator.integers(8))
    return bytes(changed)


def _cut(content: bytes, generator: np.random.Generator) -> bytes:
    return content[: _place(content, generator)]


def _remove_or_double(content: bytes, generator: np.random.Generator) -> bytes:
    """Leave a piece out, or repeat it anywhere."""
    start, other = _place(content, generator), _place(content, generator)
    length = int(2.0 ** generator.uniform(0.0, 10.0))
    if generator.random() < 0.5:
        return _replaced(content, start, length, b"")
    return _replaced(content, other, 0, content[start : start + length])


def _overwrite(content: bytes, generator: np.random.Generator) -> bytes:
    """Write random or extreme bytes over a piece."""
    length = int(2.0 ** generator.uniform(0.0, 10.0))
    pieces = (generator.bytes(length), *(byte * min(length, 16) for byte in EXTREME_BYTES))
    piece = pieces[0 if generator.random() < 0.5 else int(generator.integers(1, len(pieces)))]
    return _replaced(content, _place(content, generator), len(piece), piece)


def _insert_token(content: bytes, generator: np.random.Generator) -> bytes:
    token = TOKENS[int(generator.integers(len(TOKENS)))]
    return _replaced(content, _place(content, generator), 0, token)


def _change_number(content: bytes, generator: np.random.Generator) -> bytes:
    """Replace a number by an extreme one, or one of its digits by another."""
    found = list(NUMBER.finditer(content))
    if not found:
        return _insert_token(content, generator)
    start, end = found[int(generator.integers(len(found)))].span()
    if generator.random() < 0.5:
        other = EXTREME_NUMBERS[int(generator.integers(len(EXTREME_NUMBERS)))]
        return _replaced(content, start, end - start, other)
    return _replaced(content, end - 1, 1, str(int(generator.integers(10))).encode())


def _exchange_lines(content: bytes, generator: np.random.Generator) -> bytes:
    lines = content.splitlines(keepends=True)
    first, second = generator.integers(len(lines), size=2)
    lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


DAMAGES: tuple[Damage, ...] = (
    *(_flip_bits, _cut, _remove_or_double, _remove_or_double, _overwrite),
    *(_insert_token, _change_number, _change_number, _exchange_lines),
)


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
