"""Commands of `galen-hw`, one file each, with benchmarks and the blind proof."""
