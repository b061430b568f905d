"""creak hears where a structure stops being linear.

An online condition-monitoring service for structures under periodic excitation: it tells per node how much
of the vibration is noise and how much is nonlinear distortion. The method is the networked best linear
approximation of K. Classens et al., *Mechanical Systems and Signal Processing* 224 (2025) 112124.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("creak")
except PackageNotFoundError:  # a source tree that is not installed
    __version__ = "0+unknown"
