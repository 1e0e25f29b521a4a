"""The benchmark of faults: recordings that are damaged as laboratories damage them, and what fgpose says of each."""
