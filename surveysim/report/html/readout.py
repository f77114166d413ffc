"""Readout noise and lost data of a resolved scene in words."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from surveysim.runtime.numbers import percent, short

Values = Mapping[str, Any]

_SHARED = {"detector": "of each detector", "group": "common to a readout group", "array": "common to all detectors"}


def _readout_noise(section: Values) -> Iterator[str]:
    for shared, words in _SHARED.items():
        if part := section[shared]:
            level = "the white noise" if part["psd_mk2_hz"] is None else f"{short(part['psd_mk2_hz'])} mK2 / Hz"
            slope = f"falls as f^(-{short(part['slope'])})"
            yield f"1/f noise {words}: its PSD equals {level} at {short(part['knee_hz'])} Hz and {slope}."


def _lines(section: Sequence[Values]) -> Iterator[str]:
    for line in section:
        yield (
            f"{short(line['rms_mk'])} mK rms at {short(line['frequency_hz'])} Hz, {short(line['width_hz'])} Hz wide,"
            f" {_SHARED[line['shared']]}."
        )


def _glitches(section: Values) -> Iterator[str]:
    least, largest = section["amplitude_mk"], section["largest_amplitude_mk"]
    sizes = short(least) if largest is None else f"{short(least)} to {short(largest)}"
    yield f"{short(3600 * section['rate_hz'])} an hour in each detector, of {sizes} mK,"
    yield f"that decay in {short(section['decay_time_s'])} s."
    if section["found"] is not None:
        yield f"{percent(section['found'])} of them are found and flagged."
    else:
        yield f"Those above {short(section['threshold'])} standard deviations of a sample are found and flagged."


def _dropped_samples(section: Values) -> Iterator[str]:
    yield f"Gaps of {short(section['length_s'])} s, {short(3600 * section['rate_hz'])} an hour,"
    yield f"{_SHARED[section['shared']]}."


def _dead_time(section: Values) -> Iterator[str]:
    yield f"{percent(section['detectors'])} of the detectors and {percent(section['scans'])} of the scans are lost,"
    yield "others in each observation."


DESCRIPTIONS: dict[str, Callable[[Any], Iterator[str]]] = {
    "readout_noise": _readout_noise,
    "lines": _lines,
    "glitches": _glitches,
    "dropped_samples": _dropped_samples,
    "dead_time": _dead_time,
}
