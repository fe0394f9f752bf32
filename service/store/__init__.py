"""Bounded stores of a server: plans, reviews and scenes in SQLite, uploads in a folder."""

from __future__ import annotations

from service.store.clouds import (
    CLOUD_ID,
    UPLOAD_SUFFIXES,
    CloudLimits,
    CloudStats,
    CloudStore,
    Upload,
    find_damaged_uploads,
)
from service.store.errors import (
    DamagedError,
    DiskError,
    NotStoredError,
    ReviewRefusedError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)
from service.store.lists import DIRECT, ListedPlan, ListedScene, PlanFilter
from service.store.records import (
    Decision,
    PlanRecord,
    PlanState,
    Review,
    StoreLimits,
    StoreStats,
)
from service.store.scenes import Scenes
from service.store.store import Store

__all__ = [
    "CLOUD_ID",
    "DIRECT",
    "UPLOAD_SUFFIXES",
    "CloudLimits",
    "CloudStats",
    "CloudStore",
    "DamagedError",
    "Decision",
    "DiskError",
    "ListedPlan",
    "ListedScene",
    "NotStoredError",
    "PlanFilter",
    "PlanRecord",
    "PlanState",
    "Review",
    "ReviewRefusedError",
    "Scenes",
    "Store",
    "StoreError",
    "StoreFullError",
    "StoreLimits",
    "StoreStats",
    "TooLargeError",
    "Upload",
    "UploadRefusedError",
    "find_damaged_uploads",
]
