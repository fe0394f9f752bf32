"""Task files: tasks as data with parameters, which requests use by name."""

from service.request.task_files.expand import use_task
from service.request.task_files.files import (
    TaskFile,
    find_task_file,
    list_folders,
    list_task_files,
    list_task_paths,
    read_task_file,
)

__all__ = [
    "TaskFile",
    "find_task_file",
    "list_folders",
    "list_task_files",
    "list_task_paths",
    "read_task_file",
    "use_task",
]
