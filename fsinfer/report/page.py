"""The frame of the page: style, the few lines of script that sort tables, and the order of its parts."""

from __future__ import annotations

from collections.abc import Iterable

from fsinfer.report.html import escape

_STYLE = """
:root { --ink: #1f2a24; --soft: #5c6b62; --line: #d9dfda; --green: #2f6b45; --back: #fbfbf9; --warn: #fff4dc; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink);
  font: 16px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
header { background: var(--green); color: #fff; padding: 1.4rem 1rem; }
header h1 { margin: 0; font-size: 1.6rem; overflow-wrap: anywhere; }
header p { margin: .3rem 0 0; opacity: .9; }
main, header > div { max-width: 62rem; margin: 0 auto; }
main { padding: 0 1rem 3rem; }
h2 { margin: 2rem 0 .6rem; font-size: 1.25rem; border-bottom: 2px solid var(--line); padding-bottom: .2rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .7rem; margin: 1.2rem 0; }
.tile { background: #fff; border: 1px solid var(--line); border-radius: .5rem; padding: .6rem .8rem; }
.tile b { display: block; font-size: 1.45rem; line-height: 1.2; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: .85rem; }
.warnings, .alarm { background: var(--warn); border-left: .3rem solid #d99a1b; border-radius: .3rem; }
.warnings { padding: .7rem 1rem .7rem 2rem; } .alarm { padding: .7rem 1rem; font-weight: 600; }
.missing, .note { color: var(--soft); }
.wide { overflow-x: auto; border: 1px solid var(--line); border-radius: .4rem; background: #fff; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
.sortable { width: 100%; font-size: .9rem; }
.sortable th { position: sticky; top: 0; background: #eef2ee; cursor: pointer; text-align: left; white-space: nowrap; }
.sortable th, .sortable td { padding: .35rem .6rem; border-bottom: 1px solid var(--line); }
.sortable td { white-space: nowrap; } .sortable td:last-child { white-space: normal; min-width: 20rem; }
.sortable th[data-order="1"]::after { content: " \\2191"; } .sortable th[data-order="-1"]::after { content: " \\2193"; }
tr.doubtful td { background: #fff9ea; } tr.unmeasured td { color: var(--soft); background: #f6f6f4; }
.facts th { text-align: left; font-weight: 500; color: var(--soft); padding: .2rem 1.2rem .2rem 0;
  vertical-align: top; }
.facts td { padding: .2rem 0; overflow-wrap: anywhere; }
figure { margin: 0; background: #fff; border: 1px solid var(--line); border-radius: .4rem; overflow: hidden; }
figure img { display: block; width: 100%; height: auto; } figcaption { padding: .4rem .7rem; font-size: .85rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 18rem), 1fr)); gap: .8rem; }
.pair { display: grid; align-items: start; grid-template-columns: repeat(auto-fit, minmax(min(100%, 15rem), 1fr));
  gap: .5rem; margin-bottom: .8rem; }
.single { max-width: 46rem; } .scatter { height: 70vh; min-height: 22rem; max-height: 42rem; }
details { margin: .6rem 0; } summary { cursor: pointer; color: var(--green); }
pre { overflow-x: auto; background: #f1f3f0; padding: .7rem; border-radius: .4rem; font-size: .8rem; }
@media print { header { background: none; color: #000; } .scatter { display: none; } figure { break-inside: avoid; } }
"""

_SCRIPT = """
document.querySelectorAll('table.sortable').forEach(function (table) {
  var heads = table.querySelectorAll('th');
  heads.forEach(function (head, column) {
    function sort() {
      var order = head.dataset.order === '1' ? -1 : 1;
      heads.forEach(function (other) { delete other.dataset.order; });
      head.dataset.order = order;
      var body = table.tBodies[0];
      Array.from(body.rows).sort(function (a, b) {
        var x = a.cells[column].dataset.key, y = b.cells[column].dataset.key;
        if (x === '' || y === '') { return (x === '') - (y === ''); }
        var difference = Number(x) - Number(y);
        return order * (isNaN(difference) ? x.localeCompare(y) : difference);
      }).forEach(function (row) { body.appendChild(row); });
    }
    head.addEventListener('click', sort);
    head.addEventListener('keydown', function (event) {
      if (event.key === 'Enter' || event.key === ' ') { event.preventDefault(); sort(); }
    });
  });
});
"""


def render_page(title: str, subtitle: str, parts: Iterable[str]) -> str:
    """Return the whole page; ``parts`` are HTML, the rest is plain text."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>"
        f"<header><div><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></div></header>"
        f"<main>{''.join(parts)}</main><script>{_SCRIPT}</script></body></html>\n"
    )
