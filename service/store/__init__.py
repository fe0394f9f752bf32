"""What a server keeps: plans, reviews and scenes in SQLite, uploaded clouds in a folder; both bounded."""

from __future__ import annotations

from service.store.clouds import CLOUD_ID, UPLOAD_SUFFIXES, CloudLimits, CloudStats, CloudStore, Upload
from service.store.errors import (
    DiskError,
    NotStoredError,
    ReviewRefusedError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)
from service.store.records import (
    Begun,
    Decision,
    Outcome,
    PlanRecord,
    PlanState,
    Review,
    StoreLimits,
    StoreStats,
)
from service.store.store import Store

__all__ = [
    "CLOUD_ID",
    "UPLOAD_SUFFIXES",
    "Begun",
    "CloudLimits",
    "CloudStats",
    "CloudStore",
    "Decision",
    "DiskError",
    "NotStoredError",
    "Outcome",
    "PlanRecord",
    "PlanState",
    "Review",
    "ReviewRefusedError",
    "Store",
    "StoreError",
    "StoreFullError",
    "StoreLimits",
    "StoreStats",
    "TooLargeError",
    "Upload",
    "UploadRefusedError",
]
