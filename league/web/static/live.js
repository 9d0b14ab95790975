// What htmx does not know: when a part of a page stays as it is, and what to say without an answer.
"use strict";

document.addEventListener("htmx:before:request", (event) => {
  const part = event.detail.ctx.sourceElement;
  // A link that has the focus would lose it.
  const used = part.matches("[data-live=list]") && part.contains(document.activeElement);
  // The next race waits until the one that is shown is over, and so does a result.
  const race =
    part.matches("[data-newest], [data-live=heat]") && document.querySelector(".player")?.player;
  if (document.hidden || used || (race && !race.over)) event.preventDefault();
});

function say({ detail: { ctx, error } }) {
  const refusal = document.getElementById("refusal");
  if (!refusal) return;
  refusal.textContent = error
    ? "The server did not answer: try again."
    : `The server answered ${ctx.response.status}.`; // until its own sentence is there
  refusal.hidden = false;
}
document.addEventListener("htmx:response:error", say);
document.addEventListener("htmx:error", say);

// A click with such a key opens a tab or a window; htmx 4.0.1 would swallow it.
function leaveToTheBrowser(event) {
  const other = event.ctrlKey || event.metaKey || event.shiftKey;
  if (other && event.target.closest("a[hx-boost]")) event.stopPropagation();
}
document.addEventListener("click", leaveToTheBrowser, { capture: true });
