"""Stage 1: from images to per-view 2D and absolute 3D joints, on onnxruntime."""
