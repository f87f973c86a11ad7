"""Links of pages to files that the site does not have, such as `../src/env/mod.rs`, become plain text."""

import re

FILE = re.compile(r"\[([^\]]+)\]\(\.\./[^)]*\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """The text of a page without such links."""
    return FILE.sub(r"\1", markdown)
