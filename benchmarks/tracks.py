"""How fast tracks are drawn from seeds, whether they differ, and how true the home track is."""

import time
from pathlib import Path

import numpy as np

from benchmarks.report import figure, heading
from league.track import files, generate

SEEDS = 1000
REFERENCE = Path(__file__).parents[2] / "shared" / "tracks" / "reinvent_base.npy"


def shape(center: np.ndarray) -> np.ndarray:
    """Return 64 points of a centreline, seen from its start line, (64, 2)."""
    points = center[np.linspace(0, len(center), 64, endpoint=False).astype(int)] - center[0]
    ahead = center[1] - center[0]
    cos, sin = ahead / np.linalg.norm(ahead)
    return points @ np.array([[cos, -sin], [sin, cos]])


def main() -> None:
    """Print the figures."""
    heading("Tracks")
    start = time.process_time()
    tracks = [generate.generate(seed) for seed in range(SEEDS)]
    figure("drawing 1,000 tracks, processor time", time.process_time() - start, "s", 60, most=True)
    assert min(track.min_radius for track in tracks) > 0.45, "a bend is tighter than asked"
    shapes = np.stack([shape(track.center) for track in tracks]).reshape(SEEDS, -1)
    squares = (shapes**2).sum(axis=1)
    apart = squares[:, None] + squares[None] - 2 * shapes @ shapes.T
    np.fill_diagonal(apart, np.inf)
    figure("closest two of them, root mean square", float(np.sqrt(apart.min() / 64)), "m")
    figure("clockwise ones", 100 * np.mean([t.direction == "clockwise" for t in tracks]), "%")
    if REFERENCE.exists():
        reference = np.load(REFERENCE)[:, :2]
        ours = files.load("reinvent_2018").center
        gaps = np.linalg.norm(reference[:, None] - ours[None], axis=2).min(axis=1)
        figure("reinvent_2018 from the reference, mean", 100 * gaps.mean(), "cm", 2, most=True)
        figure("reinvent_2018 from the reference, largest", 100 * gaps.max(), "cm", 5, most=True)


if __name__ == "__main__":
    main()
