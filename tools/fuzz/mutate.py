"""Inputs of our own making, for where atheris is not: mutations of what a parser takes, joined and cut, and plain noise."""

import random
from collections.abc import Sequence

LONGEST = 4096


def mutated(rng: random.Random, pool: Sequence[bytes]) -> bytes:
    """One input."""
    if rng.random() < 0.05:
        return rng.randbytes(rng.randint(0, 80))
    data = bytearray(rng.choice(pool))
    for _ in range(rng.randint(1, 6)):
        _change(rng, data, pool)
    return bytes(data[:LONGEST])


def _change(rng: random.Random, data: bytearray, pool: Sequence[bytes]) -> None:
    size = len(data)
    place = rng.randint(0, size)
    match rng.randint(0, 5):
        case 0:
            data[place : place + 1] = rng.randbytes(1)
        case 1:
            data[place:place] = rng.randbytes(rng.randint(1, 8))
        case 2:
            del data[place : place + rng.randint(1, 16)]
        case 3:
            data[place:place] = data[rng.randint(0, size) :][: rng.randint(1, 64)] * rng.choice((1, 1, 1, 20))
        case 4 if place < size:
            data[place] ^= 1 << rng.randint(0, 7)
        case _:
            other = rng.choice(pool)
            data[place:] = other[rng.randint(0, len(other)) :]
