"""Mutations that know nothing of a format, and the values that numbers are set to."""

from collections.abc import Sequence
from typing import Any

import numpy as np

INTEGERS = (0, 1, -1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**32, 2**53 + 1, 2**60,
            2**62, 2**63 - 1, 2**63, -(2**63), 2**64 - 1, 1_700_000_000, 1_700_000_000_000_000_000)  # fmt: skip
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-300, 5e-324, 1e9, 1e15, 1e30, 1e100, 1e154, 1e200, 1e300, 1.7e308, -1.7e308,
          float("inf"), float("-inf"), float("nan"))  # fmt: skip
TEXTS = ("", "\x00", "/", "[red]x[/red]", "[/]", "[link=file:///etc/passwd]x", "\x1b[2J\x1b]0;x\x07", "\u202egpj",
         "ä" * 3, "\ud7ff\U0001f980", "a" * 300, "A" * 100_000, "nan", "1e999", "<script>alert(1)</script>",
         "$\\frac{1}{$", "a\nb", "/slam/pose", "/tf", "odom", "base_link", "map", "{}", "%s%n", "../../x")  # fmt: skip


def one_of(values: Sequence[object], rng: np.random.Generator) -> Any:
    return rng.choice(np.array(values, dtype=object))


def mutate_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """A few changes anywhere: bits, bytes, numbers, pieces left out, doubled or exchanged, the end cut off."""
    data = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 2, 5, 20]))):
        if not data:
            break
        place = int(rng.integers(len(data)))
        length = min(int(rng.choice([1, 2, 4, 8, 40, 1000])), len(data) - place)
        match int(rng.integers(8)):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place : place + length] = rng.bytes(length)
            case 2:
                del data[place : place + length]
            case 3:
                data[place:place] = data[place : place + length]
            case 4:
                source = int(rng.integers(len(data)))
                data[place : place + length] = data[source : source + length]
            case 5:
                value = int(one_of(INTEGERS, rng))
                size = int(rng.choice([1, 2, 4, 8]))
                data[place : place + size] = (value % 256**size).to_bytes(size, "little")
            case 6:
                place -= place % 4
                data[place : place + 8] = np.array([rng.choice(FLOATS)], dtype="<f8").tobytes()
            case 7:
                del data[place if rng.random() < 0.3 else max(place, len(data) - 1000) :]
    return bytes(data)


def mutate_text(content: bytes, rng: np.random.Generator) -> bytes:
    """A few changes of words and lines, as a table or a settings file has them; sometimes of bytes."""
    if rng.random() < 0.2:
        return mutate_bytes(content, rng)
    lines = content.decode(errors="replace").splitlines()
    for _ in range(int(rng.choice([1, 1, 2, 5]))):
        if not lines:
            break
        row = int(rng.integers(len(lines)))
        match int(rng.integers(7)):
            case 0:
                del lines[row]
            case 1:
                lines.insert(int(rng.integers(len(lines) + 1)), lines[row])
            case 2:
                lines[row] = _odd_word(rng)
            case 3:
                lines[row] += ("," if "," in lines[row] else " ") + _odd_word(rng)
            case _:
                separator = "," if "," in lines[row] else " "
                words = lines[row].split(separator)
                words[int(rng.integers(len(words)))] = _odd_word(rng)
                lines[row] = separator.join(words)
    start = b"\xef\xbb\xbf" if rng.random() < 0.05 else b""
    end = "\r\n" if rng.random() < 0.05 else "\n"
    return start + (end.join(lines) + end).encode(errors="surrogatepass")


def _odd_word(rng: np.random.Generator) -> str:
    match int(rng.integers(6)):
        case 0:
            return repr(float(rng.choice(FLOATS)))
        case 1:
            return str(one_of(INTEGERS, rng))
        case 2:
            return str(one_of(TEXTS, rng))
        case 3:
            return "9" * int(rng.choice([20, 400, 5000]))
        case 4:
            return str(rng.choice(["[", "{", '"', "'", "#", "=", "-", "a.b"])) * int(rng.choice([1, 3, 3000]))
        case _:
            return repr(float(rng.normal()) * 10.0 ** int(rng.integers(-10, 20)))
