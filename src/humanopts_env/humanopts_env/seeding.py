"""Random generators keyed by purpose, so that a draw never depends on the order of others."""

import hashlib

import numpy as np


def generator(seed: int, *purpose: str | int) -> np.random.Generator:
    """
    Return the generator of one purpose.

    :param seed: seed of the run, 0 or greater.
    :param purpose: key of the draws, such as ``'start_state', option, number``; equal seeds and
        purposes give the same numbers in every process and on every machine.
    :raises ValueError: seed is negative.
    """
    if seed < 0:
        raise ValueError(f'the seed is {seed}, but must be 0 or greater')
    text = '\x1f'.join(str(part) for part in purpose)
    digest = hashlib.sha256(text.encode()).digest()
    return np.random.default_rng([seed, *np.frombuffer(digest, dtype=np.uint32).tolist()])
