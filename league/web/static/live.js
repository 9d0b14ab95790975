// Keeps what is on a page up to date while it is looked at, and shows one race after the other.
"use strict";

const EVERY_MS = 4000;
const WAITING_MS = 1500; // for a heat's page until its race can be watched

async function fetched() {
  const answer = await fetch(location.href.split("#")[0]).catch(() => null);
  return answer?.ok ? new DOMParser().parseFromString(await answer.text(), "text/html") : null;
}

async function refresh() {
  if (document.hidden) return;
  const page = await fetched();
  const [old, now] = [document, page].map((one) => one?.querySelector("[data-live]"));
  if (old && page && !now) {
    // The race is over: its page is another one, and plays it.
    history.replaceState(null, "", "#play");
    location.reload();
    return;
  }
  // A link that has the focus would lose it.
  if (old && now && old.innerHTML !== now.innerHTML && !old.contains(document.activeElement)) {
    old.replaceChildren(...document.adoptNode(now).childNodes);
  }
}

/** Put the newest race in the place of one that has ended, as soon as there is a newer one. */
async function next(screen) {
  const now = (await fetched())?.querySelector("[data-newest]");
  if (!now || now.dataset.newest === screen.dataset.newest) {
    setTimeout(() => next(screen), EVERY_MS);
    return;
  }
  screen.dataset.newest = now.dataset.newest;
  screen.replaceChildren(...document.adoptNode(now).childNodes);
  begin(screen.querySelector("[data-replay]"));
}

document.addEventListener("raceend", (event) => {
  const screen = event.target.closest("[data-newest]");
  if (screen) next(screen);
});

const waits = document.querySelector("[data-live=heat]");
if (document.querySelector("[data-live]")) setInterval(refresh, waits ? WAITING_MS : EVERY_MS);
