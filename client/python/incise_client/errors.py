"""What a Client raises besides ValueError."""

from incise.wire import ErrorCode


class ConnectError(Exception):
    """The server could not be reached or refused us, or the connection has ended. The text says why.

    ``code`` is the server's reason, a wire.ErrorCode: Unauthorized, BladeTaken, ... Unknown where it gave none.
    """

    def __init__(self, text: str, code: int = ErrorCode.ErrorCode.Unknown) -> None:
        super().__init__(text)
        self.code = code


class RequestError(Exception):
    """The server refused one message; the connection goes on. The text says why, ``code`` is its wire.ErrorCode, and ``sequence``
    the number of the message, which the send functions return.
    """

    def __init__(self, text: str, code: int, sequence: int) -> None:
        super().__init__(text)
        self.code = code
        self.sequence = sequence
