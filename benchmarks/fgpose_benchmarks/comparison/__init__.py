"""What all benchmarks share: methods on recordings, their scores, tables and the look of figures."""
