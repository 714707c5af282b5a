"""A hook of MkDocs: code blocks without the marks that `tests/test_docs.py` reads, for other renderers."""

from __future__ import annotations

import re
from typing import Any


def on_page_markdown(markdown: str, **page: Any) -> str:
    """The text of a page with only the language after the fence."""
    return re.sub(r"^```(\w+) .+$", r"```\1", markdown, flags=re.MULTILINE)
