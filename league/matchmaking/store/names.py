"""Names of entries and owners: which are refused, and which look alike."""

from __future__ import annotations

import unicodedata

from league.errors import StoreError, brief

INVISIBLE = {
    *"\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0",
    *map(chr, range(0x180B, 0x1810)),
    *map(chr, range(0xFE00, 0xFE10)),
    *map(chr, range(0xE0100, 0xE01F0)),
}
"""Characters that count as printable but show nothing: fillers and variation selectors."""

TOGETHER = {"LATIN", "CJK", "IDEOGRAPHIC", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO"}
"""Scripts that are written together; letters of any other script stand alone."""

_PAIRS = (
    "\u0430a \u0432b \u0435e \u0455s \u0456i \u0458j \u043ak \u043cm \u043dh \u043eo \u0440p "
    "\u0441c \u0442t \u0443y \u0445x \u04bbh \u0501d \u051bq \u051dw \u04cfl \u0131i "
    "\u03b1a \u03b5e \u03b9i \u03bak \u03bdv \u03bfo \u03c1p \u03c4t \u03c5u \u03c7x \u03f2c "
    "\u03f3j"
)
LOOKALIKES = {ord(pair[0]): pair[1] for pair in _PAIRS.split()}
"""Cyrillic and Greek small letters, and the dotless i, with the Latin ones that they look like."""


def skeleton(name: str) -> str:
    """Return what a name looks like: equal for names that a reader may confuse."""
    folded = unicodedata.normalize("NFKC", name).casefold().translate(LOOKALIKES)
    return " ".join(folded.split())


def check(name: str, what: str) -> None:
    """Refuse a name that cannot be shown, or that passes for another.

    Raises:
        StoreError: it is too long, not printable, holds invisible characters or mixes scripts.
    """
    if not 1 <= len(name) <= 100 or not name.isprintable() or name != name.strip():
        raise StoreError(
            f"{what} is {brief(name)}: give 1 to 100 printable characters without spaces around"
        )
    if INVISIBLE & set(name) or not skeleton(name):
        raise StoreError(f"{what} is {name!a}: leave out characters that cannot be seen")
    scripts = {_script(letter) for letter in name if letter.isalpha()}
    if len(scripts) > 1 and not scripts <= TOGETHER:
        raise StoreError(
            f"{what} is {name!a}, which mixes letters of {', '.join(sorted(scripts))}: "
            "use one script"
        )


def _script(letter: str) -> str:
    """Return the script of a letter, by the first word of its Unicode name."""
    plain = unicodedata.normalize("NFKC", letter)[:1]
    return unicodedata.name(plain, "UNKNOWN").split()[0].split("-")[0]
