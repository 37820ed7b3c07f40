"""Mutate the files of the corpus at random: none may end in a traceback.

    python benchmarks/toolpath_mutations.py [--per-dialect 10000] [--seed 0]

A mutation takes out, doubles, swaps or changes characters, numbers, words and lines, or puts a line
of another file of the dialect in between. Each result is read and summarised, as ``qp-twist show``
does it; it ends in a toolpath or in a sentence (``InvalidInput``).
"""

import argparse
import random
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from corpus import CASES, Case

from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath_summary import summarize

CHARACTERS = "0123456789.,;:/=-+()[]{}<>$%#! ANXYZGMLCQE\té\x00"
NUMBERS = ("1e308", "nan", "inf", "-0", "1e-320", "", "99999999999999999999", "0", "-1", "1e5")


def mutated(text: str, others: Sequence[str], rng: random.Random) -> str:
    """A text with one to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        words = lines[at].replace(",", ", ").split(" ")
        match rng.randrange(7):
            case 0:
                cut = rng.randrange(max(1, len(text)))
                text = text[:cut] + text[cut + 1 :]
                continue
            case 1:
                cut = rng.randrange(max(1, len(text)))
                text = text[:cut] + rng.choice(CHARACTERS) + text[cut:]
                continue
            case 2:
                del lines[at]
            case 3:
                other = rng.randrange(len(lines))
                lines[at], lines[other] = lines[other], lines[at]
            case 4:
                lines.insert(at, rng.choice(rng.choice(others).split("\n")))
            case 5:
                lines[at] = lines[at].replace(rng.choice("0123456789"), rng.choice(NUMBERS), 1)
            case _:
                words[rng.randrange(len(words))] = rng.choice(words)
                lines[at] = " ".join(words)
        text = "\n".join(lines)
    return text


def attack(cases: Sequence[Case], count: int, seed: int, folder: Path) -> tuple[int, int, int]:
    """Numbers of mutations that are read, refused, and end in a traceback, which is printed."""
    rng = random.Random(seed)
    texts = [case.text for case in cases if isinstance(case.text, str)]
    read = refused = wrong = 0
    for _ in range(count):
        case = rng.choice(cases)
        if isinstance(case.text, bytes):
            content = bytearray(case.text)
            for _ in range(rng.randint(1, 8)):
                content[rng.randrange(len(content))] = rng.randrange(256)
            other: str | bytes = bytes(content)
        else:
            other = mutated(case.text, texts, rng)
        try:
            summarize(replace(case, text=other).read(folder))
            read += 1
        except InvalidInput:
            refused += 1
        except Exception:  # the traceback that is looked for
            wrong += 1
            print(f"--- {case}, seed {seed}\n{other!r}\n{traceback.format_exc(limit=-3)}")
    return read, refused, wrong


def main() -> None:
    """Attack each dialect, and print a row of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--per-dialect", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--dialect", help="one of them alone")
    given = parser.parse_args()
    warnings.simplefilter("error")
    print("| dialect | read | refused | traceback |\n|---|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        for dialect in dict.fromkeys(case.dialect for case in CASES):
            if given.dialect in (None, dialect):
                cases = [case for case in CASES if case.dialect == dialect]
                row = attack(cases, given.per_dialect, given.seed, Path(folder))
                print(f"| {dialect} | {' | '.join(map(str, row))} |", flush=True)


if __name__ == "__main__":
    main()
