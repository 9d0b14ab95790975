"""Web pages and JSON of a league, and what it takes over HTTP; `app.make_app`, `server.serve`."""
