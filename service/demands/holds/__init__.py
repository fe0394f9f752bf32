"""What a hand holds and presses: parts with what the scan shows of them, and single kinds of holds."""
