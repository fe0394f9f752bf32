"""Things a simulated scene is made of, each with the truth about itself."""
