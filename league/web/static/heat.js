// A heat's page: charts and events follow the player, and a click on a chart of time leads it there.
"use strict";

function follow(root) {
  const marks = [...document.querySelectorAll("svg[data-time-from]")].map((chart) => {
    const [from, to, left, right] = ["timeFrom", "timeTo", "left", "right"].map((name) =>
      Number(chart.dataset[name]),
    );
    const line = chart.querySelector(".now");
    chart.addEventListener("click", (event) => {
      const { x } = new DOMPoint(event.clientX, event.clientY).matrixTransform(
        chart.getScreenCTM().inverse(),
      );
      const time = from + ((x - left) / (right - left)) * (to - from);
      root.dispatchEvent(new CustomEvent("seekto", { detail: time }));
    });
    return (time) => {
      const x = left + ((Math.min(Math.max(time, from), to) - from) / (to - from)) * (right - left);
      line.setAttribute("x1", x.toFixed(1));
      line.setAttribute("x2", x.toFixed(1));
    };
  });
  const events = [...document.querySelectorAll(".events a[data-time]")];
  let latest = null;
  root.addEventListener("racetime", ({ detail: time }) => {
    for (const mark of marks) mark(time);
    const now = events.filter((event) => Number(event.dataset.time) <= time).pop() ?? null;
    if (now === latest) return;
    latest?.removeAttribute("aria-current");
    now?.setAttribute("aria-current", "step");
    latest = now;
  });
}

function followAll() {
  for (const root of document.querySelectorAll(".player[data-keys]")) follow(root);
}

followAll();
document.addEventListener("htmx:after:swap", followAll); // of a heat that was waited for
