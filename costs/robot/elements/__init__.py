"""Elements of a URDF, each read and checked by itself: collision shapes, joints, masses, and bases that move."""
