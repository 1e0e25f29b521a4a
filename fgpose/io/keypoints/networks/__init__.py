"""The joints of monocular networks, in 3D and 2D, as users save them: SAM 3D Body and NLF."""
