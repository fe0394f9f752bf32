"""Points to convex pieces that cover what is there and leave free what was seen free."""
