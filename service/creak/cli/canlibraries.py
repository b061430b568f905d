"""The libraries that only CAN needs: an extra, so that the demo installs without them."""

from types import ModuleType

from creak.errors import InputError


def can_support() -> ModuleType:
    """The module that opens CAN sources.

    Raises
    ------
    InputError
        If python-can or cantools is not installed.
    """
    try:
        from creak.sources import can_sources
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("creak"):
            raise
        raise InputError(f"CAN needs {error.name}, which is not installed: pip install 'creak[can]'") from None
    return can_sources
