"""Whatever the doors for tracks are fed, a sound track or a TrackError comes out, nothing else."""

import numpy as np
import pytest

from league.errors import TrackError
from league.track import build, files, importer
from league.track.track import Track

TEXTS = 5000
ARRAYS = 1000

_WORDS = (
    *("nan", ".nan", ".inf", "-.inf", "1e400", "0", "-1", "1e-9", "99999", "true", "null", "~", ""),
    *(
        "{}",
        "[]",
        "[[]]",
        "[[0, 0]]",
        "&a",
        "*a",
        "!!str",
        "!!python/name:os.system",
        "<<",
        "?",
        "|",
    ),
    *(
        "'",
        '"',
        "#",
        "- -",
        "---",
        "...",
        "%YAML 9",
        "\t",
        "\x00",
        "\u2028",
        "\ud7ff",
        "0x1f",
        "1:30",
    ),
    *(
        "2001-01-01",
        "clockwise",
        "open",
        "left",
        "right",
        "start",
        "colours: 3",
        "9" * 5000,
        "@",
        "`",
    ),
)


def _sources() -> list[str]:
    names = ("reinvent_2018", "peanut", "thread_lane")
    straight = (
        "name: a\ntitle: A\ndirection: open\nwidth: 1.0\nline: inside\n"
        "points:\n  - [0, 0]\n  - [2, 0]\n  - [4, 0.5]\n"
        "left: [[-1, 0.5], [2, 0.5], [5, 1.3]]\nright: [[-1, -0.5], [2, -0.5], [5, 0.2]]\n"
    )
    retraced = straight + "waypoints: [[0, 0], [2, 0], [2, 0], [4, 0.5]]\n"
    return [*(files.load(name).text for name in names), straight, straight, retraced]


def _mutated(text: str, generator: np.random.Generator) -> str:
    """Change a text in one to four places: characters, words, lines, numbers."""
    for _ in range(int(generator.integers(1, 5))):
        lines = text.split("\n")
        row = int(generator.integers(len(lines)))
        place = int(generator.integers(len(text) + 1))
        word = _WORDS[int(generator.integers(len(_WORDS)))]
        match int(generator.integers(8)):
            case 0:
                text = text[:place] + word + text[place:]
            case 1:
                text = text[:place] + text[place + int(generator.integers(1, 40)) :]
            case 2:
                text = text[:place] + chr(int(generator.integers(0x250))) + text[place + 1 :]
            case 3:
                lines[row] = lines[row].split(":")[0] + ": " + word
                text = "\n".join(lines)
            case 4:
                other = int(generator.integers(len(lines)))
                lines[row], lines[other] = lines[other], lines[row]
                text = "\n".join(lines)
            case 5:
                text = "\n".join(lines[:row] + lines[row + 1 :])
            case 6:
                number = f"{generator.normal(0, 10.0 ** generator.integers(-2, 4)):.3g}"
                lines[row] = f"  - [{number}, {generator.normal(0, 3):.3g}]"
                text = "\n".join(lines)
            case _:
                text = text[:place]
    return text


def _is_sound(track: Track) -> bool:
    numbers = np.concatenate([track.center, track.left, track.right])
    return bool(np.isfinite(numbers).all()) and build.sound(track) is track


def test_any_text_ends_in_a_sound_track_or_a_track_error():
    generator = np.random.default_rng(1)
    sources = _sources()
    sound = refused = 0
    for turn in range(TEXTS):
        text = _mutated(sources[turn % len(sources)], generator)
        try:
            track = files.parse(text, "fuzz")
        except TrackError as error:
            refused += 1
            assert 0 < len(str(error)) < 700
        else:
            sound += 1
            assert turn % 10 or _is_sound(track)
    # The mutations are neither all harmless nor all fatal.
    assert sound > TEXTS // 50 and refused > TEXTS // 4


def test_any_bytes_in_a_file_end_in_a_track_or_a_track_error(tmp_path):
    generator = np.random.default_rng(2)
    source = _sources()[3].encode()
    path = tmp_path / "fuzz.yaml"
    for _ in range(500):
        content = bytearray(source)
        for _ in range(int(generator.integers(1, 4))):
            content[int(generator.integers(len(content)))] = int(generator.integers(256))
        path.write_bytes(bytes(content))
        try:
            files.load(path)
        except TrackError as error:
            assert "fuzz.yaml" in str(error)


def _rows(generator: np.random.Generator) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, int(generator.integers(8, 60)))
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = np.concatenate([unit * 2, unit * 1.6, unit * 2.4], axis=1)
    match int(generator.integers(6)):
        case 0:
            rows += generator.normal(0, 10.0 ** generator.integers(-3, 2), rows.shape)
        case 1:
            rows = rows[:, generator.permutation(6)]
        case 2:
            rows = rows[generator.permutation(len(rows))]
        case 3:
            rows[int(generator.integers(len(rows)))] = generator.choice([np.nan, np.inf, 0, 1e300])
        case 4:
            rows *= 10.0 ** generator.integers(-8, 8)
        case _:
            rows = np.repeat(rows, int(generator.integers(1, 4)), axis=0)
    return rows.astype(generator.choice(["<f8", "<f4", ">f8", "<i4"]))


@pytest.mark.filterwarnings("ignore:invalid value encountered in cast")
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_any_array_file_ends_in_a_sound_track_or_a_track_error(tmp_path):
    generator = np.random.default_rng(3)
    path = tmp_path / "fuzz.npy"
    sound = refused = 0
    for turn in range(ARRAYS):
        np.save(path, _rows(generator))
        if turn % 2:
            content = bytearray(path.read_bytes())
            for _ in range(int(generator.integers(1, 5))):
                # Half of the changes hit the header.
                end = 128 if generator.random() < 0.5 else len(content)
                content[int(generator.integers(end))] = int(generator.integers(256))
            path.write_bytes(
                bytes(
                    content[: int(generator.integers(len(content)))]
                    if generator.random() < 0.1
                    else content
                )
            )
        try:
            track = importer.read_npy(path)
        except TrackError as error:
            refused += 1
            assert "fuzz.npy" in str(error)
        else:
            sound += 1
            assert turn % 10 or _is_sound(track)
    assert sound > ARRAYS // 20 and refused > ARRAYS // 4
