"""Getting out of a vehicle by many contacts: a sequence of poses in equilibrium with identical contact points."""
