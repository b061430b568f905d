"""A diagnosis for people: in words, as pictures, and as one page that needs nothing from elsewhere."""

from typing import Final

POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Content security policy of the page: it may use its own styles and pictures, and load nothing."""
