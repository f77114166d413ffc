"""Files of spectra: columns of CAMB and CLASS, two columns, and ECSV."""

import numpy as np
import pytest

from surveysim.runtime.errors import InputError
from surveysim.scene.shipped import shipped_folder
from surveysim.scene.spectrum_file import read_spectrum_file

ROWS = "2 1000 3 1 2\n10 900 3 1 2\n15000 1 3 1 2\n"
CLASS = "# dimensionless total [l(l+1)/2pi] C_l's\n# for l=2 to 15000\n#    1:l  2:TT  3:EE\n"


def test_kinds_of_spectra(tmp_path):
    """All in uK2: CLASS is over the squared temperature of the CMB, unless its header says microK."""
    (tmp_path / "camb.dat").write_text(f"# comment\n#    L    TT    EE    BB    TE\n{ROWS}")
    (tmp_path / "bare.dat").write_text(ROWS)
    (tmp_path / "two.dat").write_text("# l, D_l\n0 0\n2 1000\n10 900\n15000 1\n")
    scale = (2.7255e6) ** 2
    (tmp_path / "class.dat").write_text(f"{CLASS}2 {1000 / scale} 0\n10 {900 / scale} 0\n15000 {1 / scale} 0\n")
    (tmp_path / "class_camb.dat").write_text(f"# total C_l's (units: [microK]^2)\n#    1:l  2:TT  3:EE\n{ROWS}")
    cl = [1000 * np.pi / 3, 900 * 2 * np.pi / 110, 2 * np.pi / (15000 * 15001)]
    lines = "".join(f"{ell} {value!r}\n" for ell, value in zip((2, 10, 15000), map(float, cl), strict=True))
    head = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: ell, datatype: int64}\n"
    head += "# - {name: cl, datatype: float64, unit: uK2}\n"
    (tmp_path / "table.ecsv").write_text(f"{head}ell cl\n{lines}")
    kinds = {"camb": None, "bare": "camb", "two": None, "class": None, "class_camb": None}
    for name, kind in kinds.items():
        ell, power = read_spectrum_file(tmp_path / f"{name}.dat", kind)
        assert ell.tolist() == [2, 10, 15000], name
        assert power == pytest.approx([1000, 900, 1], rel=1e-12), name
    assert read_spectrum_file(tmp_path / "table.ecsv")[1] == pytest.approx([1000, 900, 1], rel=1e-12)


def test_the_spectrum_that_ships_is_of_camb():
    """Acoustic peak of 5730 uK2 at l = 220, and the damping tail."""
    ell, power = read_spectrum_file(shipped_folder() / "lynx_sky_spectrum.dat")
    assert (ell[0], ell[-1]) == (2, 15000)
    assert np.interp([220, 3000], ell, power) == pytest.approx([5729.3, 28.06], rel=3e-3)


def test_two_columns_of_c_ell_are_refused(tmp_path):
    """Two columns are l (l + 1) C_l / 2 pi; a header of C_l alone says that these are not."""
    for number, header in enumerate(("# l  l(l+1)C_l/2pi [uK2]", "# ell D_ell")):
        path = tmp_path / f"{number}.dat"
        path.write_text(header + "\n2 1000\n3 900\n")
        np.testing.assert_array_equal(read_spectrum_file(path), ([2, 3], [1000, 900]))
    path = tmp_path / "c_ell.dat"
    path.write_text("# l C_l [uK2]\n2 1000\n3 900\n")
    with pytest.raises(InputError, match="found a header of C_l"):
        read_spectrum_file(path)
