"""Detection of vehicle seats and of the openings through which a person leaves a vehicle."""
