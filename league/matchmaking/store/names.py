"""Names of entries and owners: what can be shown, and which two a reader may confuse."""

import re
import unicodedata
from functools import lru_cache

from league.errors import StoreError, brief

INVISIBLE = {
    *"\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0\ufffc\ufffd",
    *map(chr, range(0x180B, 0x1810)),
    *map(chr, range(0xFE00, 0xFE10)),
    *map(chr, range(0xE0100, 0xE01F0)),
}
"""Characters that count as printable but show nothing: fillers, variation selectors, and what
stands for text that was lost."""

TOGETHER = {"LATIN", "CJK", "IDEOGRAPHIC", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO"}
"""Scripts that are written together; letters of any other script stand alone."""

_PAIRS = (
    # Cyrillic
    "\u0430a \u0432b \u0435e \u0455s \u0456i \u0458j \u043ak \u043cm \u043dh \u043eo \u0440p "
    "\u0441c \u0442t \u0443y \u0445x \u04bbh \u0501d \u051bq \u051dw \u04cfl "
    # Greek
    "\u03b1a \u03b2b \u03b5e \u03b6z \u03b7n \u03b9i \u03bak \u03bcm \u03bdv \u03bfo \u03c1p "
    "\u03c4t \u03c5u \u03c7x \u03f2c \u03f3j "
    # Armenian
    "\u0563g \u0566q \u0570h \u0575j \u0578n \u057du \u0581g \u0585o "
    # Cherokee: its capitals have the forms of Latin ones
    "\u13a0d \u13a1r \u13a2t \u13a5i \u13aaa \u13abj \u13ace \u13b3w \u13b7m \u13bbh \u13c0g "
    "\u13c3z \u13cfb \u13d9v \u13dah \u13del \u13dfc \u13e2p \u13e6k \u13f4b "
    # Latin letters: their Unicode names do not tell which one they look like
    "\u00f0d \u0251a \u0269i \u01c0l \u0138k "
    # Signs
    "|l 1l 0o"
)
LOOKALIKES = {ord(pair[0]): pair[1] for pair in _PAIRS.split()} | {ord("i"): "l"}
"""Small letters, digits and signs with the Latin small letters that they look like."""

_VARIANT = re.compile(
    r"LATIN (?:SMALL |CAPITAL )?LETTER (?:SMALL CAPITAL |SCRIPT |DOTLESS |LONG |INSULAR |OPEN )?"
    r"([A-Z])(?: WITH .*)?"
)
"""Unicode names of Latin letters that are drawn like a plain one."""
_ACCENTS = re.compile("[\u0300-\u036f\u1ab0-\u1aff\u1dc0-\u1dff\u20d0-\u20ff\ufe20-\ufe2f]")
"""Marks above, below and across letters; the vowels of other scripts are none."""
_DOTS = set("\u2219\u22c5\u2212\u223c~\u00b0\u02d9\u25e6\u2223")
"""Mathematical and other signs that are as slight as punctuation."""


@lru_cache(maxsize=1 << 15)
def looks(name: str) -> frozenset[str]:
    """Return what a name may be read as; two that share a reading may be confused.

    After the skeletons of Unicode's technical standard 39, and stricter: accents, case, spaces and
    punctuation tell no names apart, nor do small raised or lowered characters, which may be read as
    if they were not there.
    """
    raised = ("<super>", "<sub>")
    plain = "".join(sign for sign in name if not unicodedata.decomposition(sign).startswith(raised))
    return frozenset(_skeleton(text) for text in {name, plain} if text)


def _skeleton(text: str) -> str:
    """Return one reading of a text: small Latin letters and digits as far as it looks like them."""
    folded = unicodedata.normalize("NFKD", text).casefold()
    bare = _ACCENTS.sub("", unicodedata.normalize("NFKD", folded))
    signs = ["" if _is_slight(sign) else sign for sign in bare]
    if not any(signs):
        return " ".join(bare.split())  # nothing but punctuation: that is the name
    # A sign between digits stays, as a space: 1.10 is not 11.0.
    parts = re.sub(r"(?<=\d)\0+(?=\d)", " ", "".join(sign or "\0" for sign in signs))
    letters = "".join(map(_plain, parts.replace("\0", "")))
    return letters.replace("rn", "m").replace("vv", "w")


def _is_slight(sign: str) -> bool:
    return (
        sign in _DOTS
        or (sign != "|" and unicodedata.category(sign)[0] in "PZC")
        or unicodedata.category(sign) == "Sk"
    )


def _plain(letter: str) -> str:
    """Return the plain letter that one looks like."""
    if not letter.isascii() and ord(letter) not in LOOKALIKES:
        match = _VARIANT.fullmatch(unicodedata.name(letter, ""))
        letter = match[1].lower() if match else letter
    return LOOKALIKES.get(ord(letter), letter)


def check_printable(name: str, what: str) -> None:
    """Refuse a name (StoreError) that is too long or cannot be printed."""
    if not 1 <= len(name) <= 100 or not name.isprintable() or name != name.strip():
        raise StoreError(
            f"{what} is {brief(name)}: give 1 to 100 printable characters without spaces around"
        )


def check_name(name: str, what: str) -> None:
    """Refuse a name (StoreError) that cannot be shown, in part or at all, or mixes scripts."""
    check_printable(name, what)
    begins_with_mark = unicodedata.category(name[0]).startswith("M")  # an accent without a letter
    if INVISIBLE & set(name) or begins_with_mark or not all(looks(name)):
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
