import crccheck.crc
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.crc import _ALIASES, CATALOGUE, by_name

KNOWN = {name: kind for kind in crccheck.crc.ALLCRCCLASSES for name in kind._names}


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_crc_of_the_check_string_is_the_catalogues(name: str) -> None:
    digits = np.frombuffer(b"123456789", np.uint8)[None]
    assert int(CATALOGUE[name].of(digits)[0]) == KNOWN[name]._check_result


@given(st.sampled_from(sorted(CATALOGUE)), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_crc_of_random_frames_is_an_independent_ones(name: str, length: int, seed: int) -> None:
    frames = np.random.default_rng(seed).integers(0, 256, (3, length), np.uint8)
    expected = [KNOWN[name].calc(frame.tobytes()) for frame in frames]
    assert by_name(name).of(frames).tolist() == expected
    size = by_name(name).size
    assert by_name(name).bytes_of(frames)[0].tobytes() == expected[0].to_bytes(size, "little")


@pytest.mark.parametrize("alias", sorted(set(_ALIASES) & set(KNOWN)))
def test_alias_means_what_the_catalogue_says(alias: str) -> None:
    digits = np.frombuffer(b"123456789", np.uint8)[None]
    assert int(by_name(alias.lower()).of(digits)[0]) == KNOWN[alias]._check_result


def test_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(ValueError, match=r'no CRC is called "CRC-16/IBM-374"; did you mean CRC-16/IBM-3740'):
        by_name("CRC-16/IBM-374")
