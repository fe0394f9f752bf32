"""Results carried out in a physics engine (MuJoCo, the extra `sim`)."""
