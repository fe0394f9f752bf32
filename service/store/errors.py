"""Errors of the stores."""

from __future__ import annotations

from service.errors import ServiceError


class StoreError(ServiceError):
    """A store that cannot be opened, read or written."""


class DiskError(StoreError):
    """A file that cannot be written, such as on a full disk.  The text names the file, and is for the server's log."""


class NotStoredError(StoreError):
    """A plan, scene or upload that is not in the store."""


class DamagedError(StoreError):
    """Stored data that are not what was written.  The text names them by their id, and is for clients.

    Attributes:
        detail: file and error for the server's log; may be empty.
    """

    def __init__(self, text: str, detail: str = "") -> None:
        super().__init__(text)
        self.detail = detail


class ReviewRefusedError(StoreError):
    """A review that does not fit the stored plan."""


class TooLargeError(StoreError):
    """An entry larger than the store accepts."""


class StoreFullError(StoreError):
    """A store without space until an entry in use is released; another try may succeed."""


class UploadRefusedError(StoreError):
    """An upload of an unknown kind, or an empty one."""
