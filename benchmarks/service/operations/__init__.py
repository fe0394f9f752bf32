"""What operators rely on: fair shares, load of any size, stopped and killed processes, damaged files, odd messages."""
