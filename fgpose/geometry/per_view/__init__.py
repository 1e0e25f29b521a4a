"""What the 3D joints of one view alone tell: absolute joints from relative ones, and the distances of joints."""
