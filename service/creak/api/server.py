"""The application on a port."""

import socket

import uvicorn
from fastapi import FastAPI

from creak.api.events import EventFeed
from creak.errors import AddressError

_GRACE_SECONDS = 2


class Server(uvicorn.Server):
    """A server that ends promptly: open event streams would otherwise hold it.

    Parameters
    ----------
    app : FastAPI
        Made by `creak.api.create_app`.
    listener : socket.socket
        Listening; closed when the server ends.
    """

    def __init__(self, app: FastAPI, listener: socket.socket) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=_GRACE_SECONDS,
            )
        )
        self._feed: EventFeed = app.state.feed
        self._listener = listener

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on."""
        host, port, *_ = self._listener.getsockname()
        return host, port

    def listen(self) -> None:
        """Serve until `stop`, or in the main thread until SIGINT or SIGTERM, which is raised again at the end."""
        try:
            self.run(sockets=[self._listener])
        finally:
            self._listener.close()

    def stop(self) -> None:
        """End soon; may be called from any thread."""
        self.should_exit = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the event streams first, then wait for what else is under way."""
        self._feed.close()
        await super().shutdown(sockets)


def listen_on(host: str, port: int) -> socket.socket:
    """Take an address at once, so that one in use is known before anything else begins.

    Parameters
    ----------
    host : str
    port : int
        0 for any free one.

    Raises
    ------
    AddressError
        If the address is in use, or none of this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    except (OSError, OverflowError) as error:
        raise AddressError(f"{host}:{port}: {error}") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()  # two sockets may be bound to one port, only one can listen; early clients wait
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise AddressError(f"{host}:{port}: cannot listen here: {reason}") from error
    return listener


def bind(app: FastAPI, host: str, port: int) -> Server:
    """Make a server of an application on an address of its own, see `listen_on`."""
    return Server(app, listen_on(host, port))
