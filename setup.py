"""The compiled kernel as a part of the installation; all else is in pyproject.toml."""

import runpy
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
KERNEL = runpy.run_path(str(ROOT / "costs" / "native" / "build.py"))


class BuildKernel(build_ext):
    """Builds a library that knows nothing of Python; without a compiler the installation goes on."""

    def get_ext_filename(self, fullname: str) -> str:
        """Return the library's path: it has no tag of a Python version."""
        return str(Path(*fullname.split(".")).with_suffix(".so"))

    def build_extension(self, ext: Extension) -> None:
        """Build it."""
        reason = KERNEL["build"](Path(self.get_ext_fullpath(ext.name)), ROOT)
        if reason:
            raise RuntimeError(f"the compiled kernel was not built: {reason}")


setup(
    ext_modules=[Extension("costs.native.kernel", list(KERNEL["SOURCES"]), optional=True)],
    cmdclass={"build_ext": BuildKernel},
)
