"""Web pages and JSON of a league, on this machine only; `app.make_app` and `server.serve`."""
