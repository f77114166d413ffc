"""Random generators: independent for different keys, the same for the same key."""

from itertools import combinations, product

import numpy as np

from surveysim.runtime.rng import RandomPurpose, generator

N_DRAWS = 4000


def test_stages_have_numbers_of_their_own():
    # Members with one number would be aliases: in __members__, but not in the iteration.
    assert len(RandomPurpose.__members__) == len({int(stage) for stage in RandomPurpose}) == len(list(RandomPurpose))


def test_numbers_of_stages_stay():
    """A number that moves changes every seeded result; new stages take new numbers."""
    names = ["WEATHER", "POINTING", "RESPONSIVITY", "ATMOSPHERE", "EXCESS", "PHOTON"]
    names += ["DETECTOR", "SKY", "UNCORRELATED", "WHITE", "SIGNAL_SIM", "JACKKNIFE"]
    assert {name: int(RandomPurpose[name]) for name in names} == {name: k for k, name in enumerate(names)}


def test_one_key_gives_one_sequence():
    first = generator(5, RandomPurpose.PHOTON, 3, realization=2).standard_normal(100)
    np.testing.assert_array_equal(first, generator(5, RandomPurpose.PHOTON, 3, realization=2).standard_normal(100))


def test_draws_of_one_generator_move_no_other():
    before = generator(5, RandomPurpose.EXCESS, 1).random(10)
    generator(5, RandomPurpose.ATMOSPHERE, 1).random(12345)
    np.testing.assert_array_equal(before, generator(5, RandomPurpose.EXCESS, 1).random(10))


def test_different_keys_give_independent_sequences():
    """One number changed at a time, or two swapped: no draw shared, and no correlation.

    The correlation of n independent pairs has the standard deviation 1 / sqrt(n); 5 of these.
    """
    keys = list(product((0, 1), (RandomPurpose.POINTING, RandomPurpose.EXCESS), (0, 1), (0, 1)))
    keys += [
        (0, RandomPurpose.RESPONSIVITY, 1, 0),
        (0, RandomPurpose.POINTING, 2, 0),
        (0, RandomPurpose.POINTING, 0, 2),
    ]
    # Blocks of an observation, of others, and numbers of other things in their place.
    keys += [(0, RandomPurpose.EXCESS, 1, 0, block) for block in (1, 2, int(RandomPurpose.EXCESS))] + [
        (0, RandomPurpose.EXCESS, 0, 1, 1)
    ]
    names = "seed", "purpose", "observation", "realization", "block"
    rngs = [generator(**dict(zip(names, key, strict=False))) for key in keys]
    draws = np.array([rng.standard_normal(N_DRAWS) for rng in rngs])
    correlation = np.corrcoef(draws)
    for i, j in combinations(range(len(keys)), 2):
        assert abs(correlation[i, j]) < 5 / np.sqrt(N_DRAWS), (keys[i], keys[j])
        assert not np.isin(draws[i], draws[j]).any(), (keys[i], keys[j])


def test_the_first_block_has_the_key_of_the_observation():
    """Observations of one block have a key without a block; the sequence is numpy's for this key."""
    found = generator(5, RandomPurpose.PHOTON, 3, realization=2, block=0).random(5)
    expected = np.random.Generator(np.random.SFC64(np.random.SeedSequence(5, spawn_key=(2, 3, 5)))).random(5)
    np.testing.assert_array_equal(found, expected)


def test_names_have_sequences_of_their_own():
    draws = [generator(1, purpose).random(4).tolist() for purpose in ("one", "other", *RandomPurpose)]
    assert len({tuple(row) for row in draws}) == len(draws)
    assert generator(1, "one").random(4).tolist() == draws[0]
    assert generator(1, "one", block=1).random(4).tolist() != draws[0]
    others = [generator(1, "one", **key).random(4).tolist() for key in ({"part": "x"}, {"part": "y"}, {"band": "x"})]
    assert len({tuple(row) for row in (draws[0], *others)}) == 4
