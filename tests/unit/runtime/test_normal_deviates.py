"""Normal deviates: known answers, a slow twin, parts of a sequence, and tests of randomness."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from surveysim.runtime import normal_kernels as kernels
from surveysim.runtime.rng import NormalDeviates, RandomPurpose, normal_deviates
from tests import naive
from tests.deviates import DeviateTests, sequence_probabilities

ONES = 0xFFFFFFFF
# Random123 (Salmon et al. 2011), file kat_vectors: counter, key and answer of philox4x32, 10 rounds.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((ONES, ONES, ONES, ONES), (ONES, ONES), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]
WORDS = (0x9E3779B1, 7, 0xFFFFFFF0, 1234567)
STREAM = NormalDeviates(WORDS)
# Of the first 10000 deviates of WORDS in both types, on any machine.
BITS = "20a95a2a8f0224f0a075b5480c24db773240f970996e7c3ec9c0802dddacab4e"
EPS = 2.0**-24
# Of one test in some forty thousand by chance; broken generators are far below.
UNLIKELY, IMPOSSIBLE = 1e-5, 1e-12


# ---------------------------------------------------------------- generator and transform


@pytest.mark.parametrize("counter, key, answer", KNOWN)
def test_known_answers(counter, key, answer):
    words = [np.uint32(word) for word in (*counter, *key)]
    assert tuple(int(word) for word in kernels.philox(*words)) == answer
    assert naive.philox(counter, key) == answer


@pytest.mark.parametrize("first", [0, 64 * 2**32 // 16 - 100, 2**50 + 37])
def test_slow_twin(first):
    """About two roundings of logarithm, root and product; near the end of the counter's first word too."""
    expected = naive.deviate(WORDS, np.arange(5000, dtype=np.uint64) + np.uint64(first))
    np.testing.assert_allclose(STREAM.draw(5000, first=first), expected, rtol=6 * EPS)
    expected = naive.deviate(WORDS, np.arange(5000, dtype=np.uint64) + np.uint64(first), refined=True)
    wide = STREAM.draw(5000, first=first, dtype=np.float64)
    np.testing.assert_allclose(wide, expected, rtol=12 * 2.0**-53)


def test_types_agree():
    """Float64 deviates have digits of their own below those of float32."""
    wide = STREAM.draw(10_000, dtype=np.float64)
    narrow = STREAM.draw(10_000)
    np.testing.assert_allclose(narrow, wide, rtol=0, atol=1e-6)
    assert np.mean(wide == narrow) < 0.01 and len(np.unique(wide)) == len(wide)


@pytest.mark.parametrize(
    "word, other", [(0, 0), (0, 0x100), (ONES, 0), (2**31, 255), (2**31 - 1, 255), (3037000499, 77)]
)
def test_ends_of_the_range(word, other):
    """The largest radius, the smallest, the middle, and where the logarithm changes its reduction (sqrt(1/2))."""
    half = np.float32(0.5)
    series = kernels._LOG_32, kernels._SIN_32, kernels._COS_32
    found = kernels._box_muller(np.uint32(word), np.uint32(other), half, half, *series)
    expected = naive.box_muller(np.uint64(word), np.uint64(other))
    np.testing.assert_allclose(found, expected, rtol=6 * EPS)
    assert np.hypot(*found) == pytest.approx(np.hypot(*expected), rel=6 * EPS) and np.hypot(*found) > 0
    if word == 0 and other == 0:
        assert np.hypot(*found) > 7.5


# ---------------------------------------------------------------- parts and keys


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_parts_equal_the_whole(dtype):
    whole = STREAM.draw(1000, first=11, dtype=dtype)
    for first, n in [(0, 1000), (1, 5), (53, 64), (53, 65), (52, 63), (117, 64), (900, 100), (999, 1), (7, 0)]:
        np.testing.assert_array_equal(STREAM.draw(n, first=11 + first, dtype=dtype), whole[first : first + n])
    out = np.empty((10, 100), dtype)
    STREAM.fill(out, 11)
    np.testing.assert_array_equal(out.ravel(), whole)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("first", "n"), [(0, 1000), (1, 5), (53, 65), (52, 63), (117, 64), (7, 0)])
def test_deviates_are_added_as_they_are_drawn(first, n, dtype):
    before = np.random.default_rng(1).standard_normal(n).astype(dtype)
    found = before.copy()
    STREAM.add(found, 0.7, first)
    expected = before + dtype(0.7) * STREAM.draw(n, first=first, dtype=dtype)
    np.testing.assert_allclose(found, expected, rtol=0, atol=4 * np.finfo(dtype).eps)


def test_arrays_that_cannot_be_filled():
    with pytest.raises(
        ValueError, match=r"^found float32 of strides \(8,\); contiguous float32 or float64 is expected$"
    ):
        STREAM.fill(np.empty(10, np.float32)[::2])
    with pytest.raises(ValueError, match="^found complex64 of strides "):
        STREAM.fill(np.empty(10, np.complex64))


def bits():
    return hashlib.sha256(STREAM.draw(10_000).tobytes() + STREAM.draw(10_000, dtype=np.float64).tobytes()).hexdigest()


def test_bits_are_the_same_on_every_machine():
    assert bits() == BITS


@pytest.mark.slow
@pytest.mark.parametrize("processor", ["generic", "haswell", "skylake-avx512"])
def test_bits_are_the_same_with_other_instructions(tmp_path, processor):
    """Vectors of 4, 8 and 16 numbers, with fused operations or without."""
    if os.uname().machine != "x86_64":
        pytest.skip("processors of x86-64")
    variables = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    code = "from tests.unit.runtime.test_normal_deviates import bits; print(bits())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables | {"PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == BITS


def test_keys_have_sequences_of_their_own():
    """Sequences of neighbouring keys share no deviate, and neither they nor their squares are correlated."""
    base = {"seed": 5, "purpose": RandomPurpose.PHOTON, "observation": 3, "realization": 2, "block": 1}
    changes = [{}, {"seed": 4}, {"seed": 6}, {"purpose": RandomPurpose.DETECTOR}, {"purpose": "photon"}]
    changes += [{"observation": k} for k in (0, 1, 2, 4, 5)] + [{"realization": k} for k in (0, 1, 3)]
    changes += [{"block": k} for k in (0, 2, 3)] + [{"observation": 2, "realization": 3}]
    streams = [normal_deviates(**base | change) for change in changes]
    assert len({stream.words for stream in streams}) == len(streams) and streams[0] == normal_deviates(**base)
    found = sequence_probabilities(np.array([stream.draw(200_000, dtype=np.float64) for stream in streams]))
    assert min(found.values()) > UNLIKELY, found


@pytest.mark.parametrize("word", range(4))
def test_neighbouring_words(word):
    """Sequences whose words differ by 1 or by one bit."""
    streams = []
    for change in (0, 1, 2, 3, 4, 8, 2**16, 2**31):
        words = list(WORDS)
        words[word] ^= change
        streams.append(NormalDeviates(tuple(words)).draw(200_000, dtype=np.float64))
    found = sequence_probabilities(np.array(streams))
    assert min(found.values()) > UNLIKELY, found


# ---------------------------------------------------------------- randomness


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("words", [WORDS, (0, 0, 0, 0)])
def test_randomness(words, dtype):
    tests = DeviateTests(tail_radius=4.0)
    tests.add(NormalDeviates(words).draw(2**22, dtype=dtype))
    found = tests.probabilities()
    assert min(found.values()) > UNLIKELY, found


@pytest.mark.parametrize("broken, test", [({"rounds": 4}, "lanes"), ({"radius_bits": 24}, "radii")])
def test_broken_generators_are_found(broken, test):
    """Too few rounds, and a uniform number of float32, at the size of the fast tests."""
    tests = DeviateTests(tail_radius=4.0)
    tests.add(naive.deviate(WORDS, np.arange(2**22, dtype=np.uint64), **broken))
    assert tests.probabilities()[test] < IMPOSSIBLE


def test_broken_keys_are_found():
    """Sequences of neighbouring keys with too few rounds."""
    position = np.arange(200_000, dtype=np.uint64)
    streams = [naive.deviate((*WORDS[:3], WORDS[3] ^ change), position, rounds=3) for change in (0, 1, 2, 3)]
    assert min(sequence_probabilities(np.array(streams)).values()) < IMPOSSIBLE


@pytest.mark.slow
def test_randomness_of_half_a_thousand_million():
    tests, piece = DeviateTests(tail_radius=5.0), np.empty(2**20, np.float32)
    for number in range(2**29 // len(piece)):
        STREAM.fill(piece, number * len(piece))
        tests.add(piece)
    found = tests.probabilities()
    assert min(found.values()) > UNLIKELY, found
