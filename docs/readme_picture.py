"""Draw the README's picture from the results of lynx: `python docs/readme_picture.py [outputs/lynx]`."""

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image
from scipy.ndimage import gaussian_filter

import surveysim

ROOT = Path(__file__).parent.parent
PICTURE = ROOT / "docs" / "_static" / "lynx.png"
WEIGHT_SHOWN = 0.06  # least weight of a pixel, of the largest
LINES = {
    "actual": ("black", "-", "actual: all noise"),
    "uncorrelated": ("#D55E00", ":", "uncorrelated: same spectra, no correlations"),
    "white": ("#009E73", "--", "white: white levels only"),
}


def main(results: Path) -> None:
    """Draw the co-added map and the noise PSDs of three data sets; write them in 256 colours."""
    scene = surveysim.load_scene(ROOT / "scenarios" / "lynx.toml")
    figure = Figure(figsize=(9.2, 3.9), dpi=110, layout="constrained")
    with fits.open(results / "maps" / "actual.fits") as file:
        header, signal, weight = file["SIGNAL"].header, file["SIGNAL"].data, file["WEIGHT"].data
    sky = figure.add_subplot(1, 2, 1, projection=WCS(header))
    pixel_rad = np.radians(header["CDELT2"])
    image = smoothed(signal, weight, scene.instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2)) / pixel_rad)
    draw_map(figure, sky, 1e3 * scene.instrument.cmb_per_rj * image, scene.score.size_rad / pixel_rad)
    sky.set_title("Map of 500 simulated observations: noise only", fontsize=10)
    noise = figure.add_subplot(1, 2, 2)
    draw_noise(noise, Table.read(results / "tables" / "map_psd.ecsv"), scene.score.ell_min)
    noise.set_title("Its noise, with and without correlations", fontsize=10)
    figure.savefig(PICTURE)
    Image.open(PICTURE).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


def smoothed(signal: np.ndarray, weight: np.ndarray, sigma_pixels: float) -> np.ndarray:
    """Smooth the signal with its weights by a Gaussian; NaN where too little weight is left."""
    total = gaussian_filter(np.nan_to_num(signal) * weight, sigma_pixels)
    spread = gaussian_filter(weight, sigma_pixels)
    return np.divide(total, spread, out=np.full(total.shape, np.nan), where=spread > WEIGHT_SHOWN * spread.max())


def draw_map(figure: Figure, axes: Axes, image: np.ndarray, side: float) -> None:
    """Draw the map [uK_CMB] with the scored square of `side` pixels."""
    span = np.nanpercentile(np.abs(image), 97)
    drawn = axes.imshow(image, origin="lower", cmap="RdBu_r", vmin=-span, vmax=span, interpolation="nearest")
    for coordinate, label in zip(axes.coords, ("Right ascension [deg]", "Declination [deg]"), strict=True):
        coordinate.set_major_formatter("d.d")
        coordinate.set_ticklabel(size=8, exclude_overlapping=True)
        coordinate.set_axislabel(label, fontsize=9)
    corner = (len(image) - side) / 2 - 0.5
    axes.plot(corner + side * np.array([0, 1, 1, 0, 0]), corner + side * np.array([0, 0, 1, 1, 0]), "k-", lw=1.2)
    axes.text(corner + 4, corner + 4, "scored", fontsize=8, bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1})
    bar = figure.colorbar(drawn, ax=axes, extend="both", fraction=0.046, pad=0.03)
    bar.set_label(r"Temperature, smoothed with the beam [$\mu$K$_{\rm CMB}$]", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def draw_noise(axes: Axes, table: Table, scored_from: float) -> None:
    """Draw the noise PSD of each data set against multipole; shade the scored multipoles."""
    for name, (colour, dashes, label) in LINES.items():
        axes.loglog(table["ell"], table[f"noise_{name}"], color=colour, ls=dashes, lw=1.8, label=label)
    axes.axvspan(scored_from, table["ell"].max(), color="0.9", label="scored multipoles")
    axes.set(xlim=(700, table["ell"].max()), ylim=(3e-5, 9e-4))
    axes.set_xlabel(r"Multipole $\ell$", fontsize=9)
    axes.set_ylabel(r"Noise PSD of the map [$\mu$K$_{\rm CMB}^2$ sr]", fontsize=9)
    axes.set_xticks([1000, 2000, 5000, 10000], ["1000", "2000", "5000", "10000"])
    axes.tick_params(which="both", labelsize=8, direction="in", top=True, right=True)
    axes.legend(fontsize=8.5, frameon=False, loc="lower left")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "outputs" / "lynx")
