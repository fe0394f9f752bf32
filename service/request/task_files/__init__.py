"""Task files: tasks as data with parameters, which requests use by name."""

from service.request.task_files.expand import use_task
from service.request.task_files.files import TaskFile, find_task_file, list_folders, list_task_files

__all__ = ["TaskFile", "find_task_file", "list_folders", "list_task_files", "use_task"]
