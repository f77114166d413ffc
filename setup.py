"""The packages of the distribution; all else stands in pyproject.toml."""

from setuptools import find_namespace_packages, setup

setup(
    packages=[*find_namespace_packages(include=["mapmaker*", "surveysim*"]), "surveysim.scenarios"],
    package_dir={"surveysim.scenarios": "scenarios"},  # scenes stay at the top of the tree, and ship in the wheel
)
