// Keeps what is on a page up to date while it is looked at.
"use strict";

const EVERY_MS = 4000;

async function refresh() {
  if (document.hidden) return;
  const answer = await fetch(location.href).catch(() => null);
  if (!answer?.ok) return;
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  const [old, now] = [document, page].map((one) => one.querySelector("[data-live]"));
  if (old && !now) location.reload(); // it is over: the page has something else to show
  // A link that has the focus would lose it.
  if (old && now && old.innerHTML !== now.innerHTML && !old.contains(document.activeElement)) {
    old.replaceChildren(...document.adoptNode(now).childNodes);
  }
}

setInterval(refresh, EVERY_MS);
