"""Versions of Python and of the packages that decide what a model computes."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("narxcal", "numpy", "scipy", "torch", "safetensors")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide what a model computes."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from a checkout that is not installed
            found[package] = "unknown"
    return found
