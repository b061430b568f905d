"""The REST API, the event stream and the page: read from the store, and strangers to the worker."""

from creak.api.app import create_app
from creak.api.server import Server, bind, listen_on

__all__ = ["Server", "bind", "create_app", "listen_on"]
