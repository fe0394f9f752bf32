"""Work of a server's worker processes: functions of data, which a ``Control`` can stop."""
