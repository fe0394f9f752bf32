"""Documents name modules, folders and pages that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "ARCHITECTURE.md", ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS_OF_ARCHITECTURE = ("", "service", "service/verify", "perception")
NAME = re.compile(r"`((?:scopt|costs|perception|service|benchmarks)(?:\.\w+)+)(?:\([^`]*\))?`")


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or a name in one."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:k])
        if path.is_dir() or path.with_suffix(".py").is_file():
            found = importlib.import_module(".".join(parts[:k]))
            for part in parts[k:]:
                found = getattr(found, part, None)
            return found is not None
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_that_a_page_names_exists(page: Path) -> None:
    names = sorted(set(NAME.findall(page.read_text())))
    assert [name for name in names if not exists(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_to_a_file_leads_somewhere(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)(?:#[^)]*)?\)", page.read_text())
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_site_has_every_page_and_describes_names_that_exist() -> None:
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())

    def list_pages(entries: Any) -> list[str]:
        if isinstance(entries, dict):
            entries = list(entries.values())
        return [entries] if isinstance(entries, str) else [page for entry in entries for page in list_pages(entry)]

    docs = ROOT / "docs"
    assert sorted(list_pages(site["nav"])) == sorted(str(path.relative_to(docs)) for path in docs.rglob("*.md"))
    described = [
        name for page in (docs / "api").glob("*.md") for name in re.findall(r"^::: (\S+)$", page.read_text(), re.M)
    ]
    assert len(described) > 20
    assert [name for name in described if not exists(name)] == []
    assert site["theme"]["font"] is False
    assert "offline" in site["plugins"]  # without it a page that is opened as a file has no search
    assert all((docs / path).is_file() for path in site["extra"]["polyfills"])


def test_pictures_of_the_documents_are_small() -> None:
    gallery = [path.stat().st_size for path in (ROOT / "docs" / "gallery").iterdir()]
    assert gallery
    assert sum(gallery) < 2**20


def test_every_folder_that_the_architecture_names_exists() -> None:
    folders = sorted(set(re.findall(r"`(\w+/)`", (ROOT / "ARCHITECTURE.md").read_text())))
    assert [name for name in folders if not any((ROOT / at / name).is_dir() for at in FOLDERS_OF_ARCHITECTURE)] == []


def test_no_folder_of_the_product_holds_more_than_twenty_modules() -> None:
    folders = {
        path.parent for name in ("scopt", "costs", "perception", "service") for path in (ROOT / name).rglob("*.py")
    }
    counts = {str(folder.relative_to(ROOT)): len(list(folder.glob("*[a-z].py"))) + 1 for folder in folders}
    assert {name: count for name, count in counts.items() if count > 20} == {}
    assert (
        len([path for path in (ROOT / "service").iterdir() if not path.name.startswith(("_", ".", "py.typed"))]) <= 30
    )
