"""Where a robot comes from: joints written out, a DH table or a URDF, with a mobile base, locks and snapping."""
