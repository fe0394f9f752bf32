"""What the sensors show: filters, measured forces, and where the pelvis is."""
