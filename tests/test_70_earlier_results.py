"""What is kept between runs comes back to the bit, and only under the key it was kept by."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest

from geomosaic.digests import digest_of
from geomosaic.mosaicking.result_cache import ResultCache, decode, encode
from geomosaic.radiometry.colour_model import Trial
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.radiometry.gain_offset import Balance


def balance(curves) -> Balance:
    rng = np.random.default_rng(1)
    gain = rng.normal(1, 0.1, (4, 3))
    return Balance(
        gain, gain - 1, np.array([1.5, np.nan, 0.1]), gain[0], 5, curves, None, (Trial(("gamma",), 0.1, True),)
    )


def shade() -> CorrectionField:
    rng = np.random.default_rng(2)
    net = rng.normal(1, 0.1, (5, 6, 3))
    return CorrectionField(net, (0.5, -3.25), (17.0, 18.5), net[0, 0], net[1, 1], np.zeros((3, 0)), 255.0)


@pytest.mark.parametrize("curves", [None, (ToneCurve([(np.arange(3.0), np.arange(3.0) ** 2)] * 3, 0.9),), (shade(),)])
def test_a_balance_comes_back_to_the_bit(curves):
    one = balance(curves)
    other = decode(json.loads(json.dumps(encode(one))))
    assert isinstance(other, Balance)
    assert encode(other) == encode(one)
    assert other.gain.tobytes() == one.gain.tobytes()
    assert other.trials == one.trials
    if curves:
        values = np.random.default_rng(3).uniform(0, 255, (4, 5, 3))
        places = (np.arange(5.0), np.arange(4.0)) if isinstance(curves[0], CorrectionField) else ()
        assert (other.curves[0](values, *places) == curves[0](values, *places)).all()


def test_only_known_results_are_kept():
    @dataclass(frozen=True)
    class Balance:  # of the same name
        gain: float

    for thing in (Balance(1.0), object(), {"a": 1}):
        with pytest.raises(TypeError, match="cannot be kept"):
            encode(thing)


def test_a_value_is_found_once_and_recalled_by_its_key_alone(tmp_path):
    found = []

    def find() -> float:
        found.append(1)
        return len(found) + 0.5

    assert ResultCache(tmp_path).get("number", "a", find) == 1.5
    again = ResultCache(tmp_path)
    assert again.get("number", "a", find) == 1.5
    assert again.from_cache == ["number"]
    assert again.get("number", "b", find) == 2.5
    (tmp_path / "number.json").write_text('{"b": {"class": "Nothing", "fields": {}}}')
    assert ResultCache(tmp_path).get("number", "b", find) == 3.5
    (tmp_path / "number.json").write_text('{"b": ')
    assert ResultCache(tmp_path).get("number", "b", find) == 4.5
    assert ResultCache(None).get("number", "b", find) == 5.5


def test_digests_tell_where_one_part_ends():
    assert digest_of("ab", "c") != digest_of("a", "bc")
    assert digest_of(np.arange(3)) == digest_of(np.arange(3)) != digest_of(np.arange(4))
