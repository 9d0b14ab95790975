"""What a run shows and writes: console, TensorBoard, plots, viewer."""
