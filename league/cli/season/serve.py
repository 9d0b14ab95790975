"""`league serve`: the league's web pages."""

from __future__ import annotations

from dataclasses import dataclass

from league.cli.season import OnLeague


@dataclass
class Serve(OnLeague):
    """Show the league in the browser, on this machine only: standings, drivers, heats, replays."""

    port: int = 8018
    """Port to listen on; 0 takes a free one."""
    host: str = "127.0.0.1"
    """Address to listen on; only 127.0.0.1 is possible yet."""

    def run(self) -> int:
        """Run the command."""
        from league.web import server

        with self.opened() as store:
            name = store.settings.name
            server.serve(
                store,
                self.port,
                host=self.host,
                ready=lambda url: print(f"{name}: {url}   (Ctrl-C ends it)", flush=True),
            )
        return 0


COMMANDS = {"serve": Serve}
