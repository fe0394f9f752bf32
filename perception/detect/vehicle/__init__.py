"""Detection of vehicle seats and of openings to leave a vehicle by."""
