"""fgpose: 3D human pose over time from several calibrated cameras, as a GTSAM factor graph."""
