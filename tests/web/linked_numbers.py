"""Which numbers of a page lead nowhere."""

from __future__ import annotations

import re

CELL = re.compile(r'<td class="[^"]*\b(?:number|places|sum)\b[^"]*">(.*?)</td>', re.S)
FIGURE = re.compile(r"<dt>(?:.*?)</dt><dd>(.*?)</dd>", re.S)
HEAT = re.compile(r'href="/heats/(\d+)\b[^"]*"[^>]*>\1[.<]')
"""A link to a heat with its number as text: the numbers of its row are of this heat."""
RACES = re.compile(
    r'href="(?:/heats|/matchups|/ghosts|/drivers/\d+#safety|#(?:racing|queue|done)")'
)


def without_heats(page: str) -> list[str]:
    """Return the cells and figures of a page with a number that does not lead to its heats."""
    rows = [row for row in re.findall(r"<tr.*?</tr>", page, re.S) if not HEAT.search(row)]
    found = [cell for row in rows for cell in CELL.findall(row)]
    for figures in re.findall(r'<dl class="figures">.*?</dl>', page, re.S):
        found += FIGURE.findall(figures)
    shown = [(one, re.sub("<[^>]*>", "", one).strip()) for one in found]
    counts = [one for one, text in shown if re.search(r"\d", text) and text != "0"]
    assert counts, "a page without numbers"
    return [one for one in counts if not RACES.search(one)]
