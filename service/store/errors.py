"""What a store has to say when it cannot keep or find something."""

from __future__ import annotations

from service.errors import ServiceError


class StoreError(ServiceError):
    """A store that cannot be opened, read or written."""


class DiskError(StoreError):
    """A disk that cannot be written: it is full, or worse.  The text names the file, and is for the server's people."""


class NotStoredError(StoreError):
    """A plan, scene or cloud that is not, or no longer, in the store."""


class ReviewRefusedError(StoreError):
    """A review of something else than the plan that is stored."""


class TooLargeError(StoreError):
    """Something of more bytes than the store takes at once."""


class StoreFullError(StoreError):
    """No room until something that is in use has ended; later may do."""


class UploadRefusedError(StoreError):
    """A cloud that cannot be taken: of an unknown kind, or empty."""
