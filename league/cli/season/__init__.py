"""The commands of a league: `league init`, `submit`, `run`, `standings` and their neighbours."""
