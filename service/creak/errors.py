"""The exceptions of creak, each also a builtin, so that a caller may catch either.

::

    CreakError
    ├── InputError (ValueError)        the caller's fault: exit code 2, HTTP 4xx
    │   ├── ConfigurationError         a file or an environment variable: names file, key, value, what is allowed
    │   ├── MeasurementError           samples that cannot be used: wrong shape, not finite, singular
    │   ├── RecordingError             a recording that is none, of another rig, or of a newer version
    │   └── RefusedAddressError        a receiver's address to which nothing may be sent
    ├── RigError (RuntimeError)        the rig's fault: it is silent, or sends what it must not
    └── ServiceError (RuntimeError)    ours or the machine's fault: exit code 1, HTTP 5xx
        ├── SimulationError            a time step that does not converge, a motion that grows without bound
        ├── StorageError (OSError)     a full disk, a store that cannot be opened
        ├── AddressError (OSError)     a port that is in use
        └── BrokerError (ConnectionError)  a message broker that cannot be reached
"""


class CreakError(Exception):
    """Root of all exceptions that creak raises on purpose; its text is one line for the user."""


class InputError(CreakError, ValueError):
    """The caller gave something that cannot be used."""


class ConfigurationError(InputError):
    """A rig, model or service file, or an environment variable, holds what is not allowed.

    Parameters
    ----------
    source : str
        File name or environment variable.
    key : str
        Dotted path of the key, for instance ``nodes[2].output``; empty if the file as a whole is meant.
    problem : str
        What is wrong and what is allowed.
    """

    def __init__(self, source: str, key: str, problem: str) -> None:
        super().__init__(f"{source}: {key}: {problem}" if key else f"{source}: {problem}")
        self.source = source
        self.key = key
        self.problem = problem

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        """Cross to another process whole; an exception is otherwise made anew of its text alone."""
        return type(self), (self.source, self.key, self.problem)


class MeasurementError(InputError):
    """Samples that cannot be used: wrong shape, not finite, or a singular input matrix."""


class RecordingError(InputError):
    """A file that is no recording of creak, or one that does not fit what is asked of it."""


class RefusedAddressError(InputError):
    """An address that is none, or that lies in a network to which nothing may be sent."""


class RigError(CreakError, RuntimeError):
    """The rig is silent or sends what it must not send."""


class ServiceError(CreakError, RuntimeError):
    """Something failed that is not the caller's fault."""


class SimulationError(ServiceError):
    """A time step that does not converge, or a motion that grows without bound."""


class StorageError(ServiceError, OSError):
    """The disk is full, or the store cannot be opened or written."""


class AddressError(ServiceError, OSError):
    """The address to listen on is in use or not to be had."""


class BrokerError(ServiceError, ConnectionError):
    """The message broker cannot be reached, or does not answer."""
