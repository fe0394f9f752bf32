"""Hook of mkdocs: formulas become MathML when the site is built, so that it loads no script for them."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

BAR = re.compile(r"\\Big\s*\\[lr][vV]ert")  # which latex2mathml does not know at a given size
# As pymdownx.arithmatex leaves them.
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', flags=re.DOTALL)


def on_page_content(text: str, **_: Any) -> str:
    """Return the HTML of a page with MathML instead of TeX."""
    return FORMULA.sub(_to_mathml, text)


def _to_mathml(found: re.Match[str]) -> str:
    tag, opening, formula = found.groups()
    display = "block" if opening == "[" else "inline"
    return f'<{tag} class="formula">{convert(BAR.sub("|", html.unescape(formula)), display=display)}</{tag}>'
