"""Files that are damaged or written by somebody malicious: mutations of valid ones."""

import random
import re

NUMBERS = (
    "0", "-0", "-1", "1e308", "-1e308", "1e400", "1e-320", "nan", "inf", "-inf", "1" + "0" * 400,
    "9" * 30, "2147483648", "-9223372036854775809", "1e9", "100000000", "0x10", "1_000", "1,5", "",
    "٣",
)  # fmt: skip
"""Texts that are put in place of a number."""
_NUMBER = re.compile(rb"[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}")
_BYTES = (b"\0", b"\xff", b"\xef\xbb\xbf", b"\r", *(bytes([b]) for b in b'"<>[{(/-&$'))


def mutated(content: bytes, number: int) -> bytes:
    """A mutation of a file's content; the same for the same number.

    One to three of: a number replaced, a word or a line removed, repeated or exchanged with another
    one, bits flipped, a piece cut out, the end cut off, a strange character inserted.
    """
    rng = random.Random(number)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        content = rng.choice(_KINDS)(content, rng)
    return content


def _other_number(content: bytes, rng: random.Random) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    at = rng.choice(found)
    return content[: at.start()] + rng.choice(NUMBERS).encode() + content[at.end() :]


def _other_word(content: bytes, rng: random.Random) -> bytes:
    found = list(_WORD.finditer(content))
    if not found:
        return content
    at, other = rng.choice(found), rng.choice([*(match[0] for match in found), b"", b"x"])
    return content[: at.start()] + other + content[at.end() :]


def _lines(content: bytes, rng: random.Random) -> bytes:
    lines = content.split(b"\n")
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(3)
    if kind == 0:
        del lines[one]
    elif kind == 1:
        lines.insert(two, lines[one])
    else:
        lines[one], lines[two] = lines[two], lines[one]
    return b"\n".join(lines)


def _bits(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 3)) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _piece(content: bytes, rng: random.Random) -> bytes:
    begin = rng.randrange(len(content) + 1)
    return content[:begin] + content[begin + rng.randrange(1, 200) :]


def _end(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _character(content: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + rng.choice(_BYTES) * rng.choice((1, 1, 1, 5000)) + content[at:]


_KINDS = (_other_number, _other_number, _other_word, _lines, _bits, _piece, _end, _character)
