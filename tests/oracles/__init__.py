"""Independent referees and recorded behaviour that the tests compare against."""
