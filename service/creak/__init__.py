"""creak hears where a structure stops being linear.

An online condition-monitoring service for structures under periodic excitation: it tells per node how much
of the vibration is noise and how much is nonlinear distortion. The method is the networked best linear
approximation of K. Classens et al., *Mechanical Systems and Signal Processing* 224 (2025) 112124.

In a notebook, ``creak.open_recording(path)`` opens a recording (`creak.notebook`).
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

__all__ = ["__version__", "open_recording"]

try:
    __version__ = version("creak")
except PackageNotFoundError:  # a source tree that is not installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    """Import what notebooks want only where it is asked for: every part of creak imports this module."""
    if name == "open_recording":
        return import_module("creak.notebook").open_recording
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
