"""Files of the scene's own sky and what comes back of it: images of the scored patch, and the transfer function."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mapmaker.fits_images import write_images
from mapmaker.geometry import wcs_cards
from surveysim.results.sky_recovery import SkyRecovery


def write_sky(
    directory: Path, recoveries: Mapping[str, SkyRecovery], header: Callable[[str], Mapping[str, object]]
) -> list[Path]:
    """Write a file for each data set, with the `header` of its name: INPUT, OUTPUT, WEIGHT and TRANSFER."""
    written = []
    for name, item in recoveries.items():
        cards, plane = wcs_cards(item.geometry), _plane_cards(item)
        images = (
            ("INPUT", item.input_mk, cards, "mK"),
            ("OUTPUT", item.output_mk, cards, "mK"),
            ("WEIGHT", item.weight, cards, "mK-2"),
            ("TRANSFER", item.transfer_plane, plane, ""),
        )
        written.append(directory / f"sky_{name}.fits")
        single = [(label, image.astype(np.float32), of, unit) for label, image, of, unit in images]
        write_images(written[-1], header(name), single)
    return written


def _plane_cards(item: SkyRecovery) -> dict[str, tuple[object, str]]:
    """Coordinates of the transfer function: multipoles along both axes, from the lower left corner of a square."""
    n = item.transfer_plane.shape[1]
    return {
        "CRPIX1": (0.5, "lower edge of the first square"),
        "CRPIX2": (n + 0.5, "edge between squares"),
        "CDELT1": (item.bin_width, "multipoles of a square"),
        "CDELT2": (item.bin_width, "multipoles of a square"),
        "CRVAL1": (0.0, ""),
        "CRVAL2": (0.0, ""),
        "CTYPE1": ("ELL_X", "multipole along right ascension"),
        "CTYPE2": ("ELL_Y", "multipole along declination"),
    }
