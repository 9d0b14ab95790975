"""Benchmarks: each checks that its result is sane, and prints ratios measured side by side."""
