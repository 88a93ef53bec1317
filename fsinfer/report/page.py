"""The frame of the page: its style, its scripts, and the links to its parts. They are files beside this module."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import resources

from fsinfer.report.html import escape


def render_page(title: str, subtitle: str, parts: Iterable[str]) -> str:
    """Return the whole page; ``parts`` are HTML, the rest is plain text."""
    body = "".join(parts)
    links = "".join(
        f'<a href="#{anchor}">{name}</a>'
        for anchor, name in re.findall(r'<section id="([a-z]+)"><h2>([^<]+)</h2>', body)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Without an icon in the page a browser asks for one beside it.
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title><style>{_asset("report.css")}</style>'
        "<script>document.documentElement.classList.add('js');</script></head><body>"
        f"<header><div><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></div></header>"
        f'<nav aria-label="Parts of the report"><div>{links}</div></nav>'
        f"<main>{body}</main><script>{_asset('viewer.js')}</script><script>{_asset('report.js')}</script>"
        "</body></html>\n"
    )


def _asset(name: str) -> str:
    return (resources.files("fsinfer.report") / "assets" / name).read_text(encoding="utf-8")
