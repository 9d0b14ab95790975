// The race player: a recorded race on a canvas. Plain JavaScript, no library; keys: docs/web.md.
"use strict";

const TRAIL_S = 1.5;
const CAPTION_S = 2.5;
const CAPTION_PX = 30; // height of a caption's line
const LEAD_S = 1; // events are shown from this long before they happen
const LATEST = 9;
const PANEL_HZ = 6;
const SAID_S = 5; // a screen reader says each new value of a slider that has the focus
const MORE_MS = 1000; // while a race is being raced, more of it is asked for so often
const JUMP_CM = 50; // a car that moved farther in one frame was put back: nothing lies between
const CAR_CM = [30, 20];
const ZOOM = 3.2;
const CHECK_CM = 9; // about the side of a check of the start line
const CHECKS = ["#f6f7f8", "#14181d"];

/** Undo `order` differences of a column of whole numbers. */
function summed(differences, order) {
  let column = Float64Array.from(differences);
  for (let turn = 0; turn < order; turn++) {
    for (let i = 1; i < column.length; i++) column[i] += column[i - 1];
  }
  return column;
}

function clock(seconds) {
  const hundredths = Math.round(seconds * 100);
  const rest = String((hundredths % 6000) / 100).padStart(2, "0");
  const [whole, part = ""] = rest.split(".");
  return `${Math.floor(hundredths / 6000)}:${whole.padStart(2, "0")}.${part.padEnd(2, "0")}`;
}

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Change the text of an element; what is not new stays as it is. */
function write(made, text) {
  if (made.textContent !== text) made.textContent = text;
}

/** A race's columns, and where every car is at any time. */
class Race {
  constructor(record) {
    Object.assign(this, record);
    for (const car of this.cars) {
      for (const name of ["x", "y", "distance"]) car[name] = summed(car[name], 2);
      for (const name of ["yaw", "gap"]) car[name] = summed(car[name], 1);
    }
    this.last = this.cars[0].x.length - 1;
  }

  at(car, time) {
    const place = Math.min(Math.max(time * this.step_hz, 0), this.last);
    const low = Math.floor(place);
    const high = Math.min(low + 1, this.last);
    const moved = Math.hypot(car.x[high] - car.x[low], car.y[high] - car.y[low]);
    const share = moved < JUMP_CM ? place - low : 0;
    const between = (column) => column[low] + (column[high] - column[low]) * share;
    return {
      x: between(car.x),
      y: between(car.y),
      yaw: between(car.yaw) / 100,
      distance: between(car.distance),
      gap: between(car.gap) / 100,
      speed: (moved < JUMP_CM ? moved * this.step_hz : 0) / 100,
      lap: Math.min(car.lap_frames.filter((frame) => frame <= place).length + 1, this.laps),
      finished: car.lap_frames.length >= this.laps && car.lap_frames[this.laps - 1] <= place,
      stopped: car.stops.some(([from, to]) => from <= place && place < to),
    };
  }
}

class Player {
  constructor(root, record, plays) {
    this.root = root;
    this.race = new Race(record);
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.follow = 0; // number of the car in the middle of the picture; 0: the whole track
    this.shownAt = -1;
    this.saidUntil = -1; // what the caption says stays up to then
    this.build();
    this.readColours();
    this.resize();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    (root.dataset.keys === "page" ? document : root).addEventListener("keydown", (event) =>
      this.key(event),
    );
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!record.over) this.grow();
    if (!this.seekToHash() && plays && !still) this.toggle("loop" in root.dataset ? "off" : "polite");
  }

  get over() {
    return this.race.over && this.time >= this.race.duration_s;
  }

  /** Ask for more of a race that is being raced, until it is over or the player has left the page. */
  async grow() {
    while (!this.race.over) {
      await new Promise((later) => setTimeout(later, MORE_MS));
      if (!this.root.isConnected) return;
      if (document.hidden) continue;
      try {
        const answer = await fetch(this.root.dataset.replay);
        if (answer.ok) this.extend(new Race(await answer.json()));
      } catch {
        // A server that is away is asked again.
      }
    }
  }

  extend(race) {
    // Another worker may have begun the same race again.
    if (!race.over && race.last < this.race.last) return;
    this.race = race;
    this.slider.max = race.duration_s;
    this.markEvents();
    this.seek(this.time);
  }

  build() {
    const { race, root } = this;
    const names = race.cars.map((car) => car.name).join(", ");
    this.canvas = element("canvas", {
      role: "img",
      "aria-label": `${race.track.title} from above, with the cars of ${names}`,
    });
    this.context = this.canvas.getContext("2d");
    this.button = element("button", { type: "button", class: "play" }, "Play");
    this.button.addEventListener("click", () => this.toggle());
    this.slider = element("input", {
      type: "range", min: 0, max: race.duration_s, step: 0.05, value: 0, "aria-label": "Race time",
    });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    // No <output>: a screen reader would say each of its changes, many in a second.
    this.clock = element("span", { class: "clock" });
    const option = (value, text) => element("option", { value }, text);
    this.pace = element(
      "select", { "aria-label": "Speed" },
      ...[0.25, 0.5, 1, 2, 4].map((pace) => option(pace, `${pace}×`)),
    );
    this.pace.value = "1";
    this.pace.addEventListener("change", () => (this.speed = Number(this.pace.value)));
    this.subject = element(
      "select", { "aria-label": "Follow" },
      option(0, "Whole track"),
      ...race.cars.map((car) => option(car.number, `Follow ${car.number} ${car.name}`)),
    );
    this.subject.addEventListener("change", () => this.watch(Number(this.subject.value)));
    const full = element("button", { type: "button" }, "Full screen");
    full.addEventListener("click", () => this.fullScreen());
    const link = element("button", { type: "button" }, "Link to this moment");
    link.addEventListener("click", () => this.link());
    this.order = element("tbody", {}, ...race.cars.map(() => element(
      "tr", {},
      element("td", {}, element("b", {})), element("td", { class: "name" }),
      ...[0, 1, 2].map(() => element("td", { class: "number" })),
    )));
    this.caption = element("p", { class: "caption", "aria-live": "polite" });
    const head = ["", "Driver", "Gap", "Lap", "m/s"].map((text) =>
      element("th", { scope: "col" }, text),
    );
    this.marks = element("div", { class: "marks", "aria-hidden": "true" });
    this.markEvents();
    const screen = element("div", { class: "screen" }, this.canvas, this.caption);
    const table = element(
      "table", { class: "order" },
      element("caption", {}, "Running order"), element("thead", {}, element("tr", {}, ...head)),
      this.order,
    );
    const bar = element(
      "div", { class: "controls" },
      this.button, element("div", { class: "scrub" }, this.marks, this.slider), this.clock,
      this.pace, this.subject, full, ...("keys" in root.dataset ? [link] : []),
    );
    this.latest = element("ol", { class: "latest", "aria-hidden": "true" });
    root.replaceChildren(screen, element("div", { class: "side" }, table, this.latest), bar);
    root.tabIndex = 0;
    root.classList.add("ready");
  }

  markEvents() {
    const { duration_s, events } = this.race;
    this.marks.replaceChildren(...events.filter(({ kind }) => kind !== "start").map((event) => {
      const mark = element("i", { class: event.kind });
      mark.style.left = `${(100 * event.time_s) / duration_s}%`;
      return mark;
    }));
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name).trim();
    this.colours = {
      field: read("--field"), road: read("--road"), line: read("--road-line"), text: read("--text"),
      cars: this.race.cars.map((car) => read(`--car-${car.number}`)),
    };
    this.ground = null;
  }

  resize() {
    const scale = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    this.canvas.width = Math.max(1, Math.round(clientWidth * scale));
    this.canvas.height = Math.max(1, Math.round(clientHeight * scale));
    this.scale = scale;
    const { left, right } = this.race.track;
    const xs = [], ys = [];
    for (const side of [left, right]) {
      for (let i = 0; i < side.length; i += 2) xs.push(side[i]), ys.push(side[i + 1]);
    }
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const margin = 30;
    // A caption that lies over the picture leaves its place free of the track.
    const over = getComputedStyle(this.caption).position === "absolute";
    const strip = over ? CAPTION_PX * scale : 0;
    const zoom = Math.min(
      this.canvas.width / (x1 - x0 + 2 * margin),
      (this.canvas.height - strip) / (y1 - y0 + 2 * margin),
    );
    this.fit = { x: (x0 + x1) / 2, y: (y0 + y1) / 2 - strip / 2 / zoom, zoom };
    this.draw();
  }

  /** Centre and zoom of the picture now. */
  camera(states) {
    if (!this.follow) return this.fit;
    const { x, y } = states[this.follow - 1];
    return { x, y, zoom: this.fit.zoom * ZOOM };
  }

  draw() {
    const { context, race, colours } = this;
    const states = race.cars.map((car) => race.at(car, this.time));
    const { x, y, zoom } = this.camera(states);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours.field;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    const { width, height } = this.canvas;
    context.setTransform(zoom, 0, 0, -zoom, width / 2 - zoom * x, height / 2 + zoom * y);
    this.drawTrack();
    for (const [index, car] of race.cars.entries()) this.drawTrail(car, colours.cars[index], zoom);
    const order = race.cars.map((_, index) => index);
    order.sort((a, b) => states[a].distance - states[b].distance);
    for (const index of order) this.drawCar(states[index], index, zoom);
    this.showPanel(states, order.reverse());
    this.root.dispatchEvent(new CustomEvent("racetime", { detail: this.time }));
  }

  drawTrack() {
    const { context, race, colours } = this;
    this.ground ??= this.trackPath();
    context.fillStyle = colours.road;
    context.fill(this.ground, "evenodd");
    context.strokeStyle = colours.line;
    context.lineWidth = 5;
    context.stroke(this.ground);
    this.drawStart(race.track);
    context.fillStyle = colours.line;
    for (let i = 0; i < race.obstacles.length; i += 2) {
      context.fillRect(race.obstacles[i] - 12, race.obstacles[i + 1] - 12, 24, 24);
    }
  }

  /** The start line, two rows of checks. */
  drawStart({ left, right }) {
    const { context } = this;
    const [x, y] = [right[0] - left[0], right[1] - left[1]];
    const across = 2 * Math.max(2, Math.round(Math.hypot(x, y) / 2 / CHECK_CM));
    const side = Math.hypot(x, y) / across;
    context.save();
    context.translate(left[0], left[1]);
    context.rotate(Math.atan2(y, x));
    for (let i = 0; i < 2 * across; i++) {
      const [place, row] = [i >> 1, i & 1];
      context.fillStyle = CHECKS[(place + row) % 2];
      context.fillRect(place * side, (row - 1) * side, side, side);
    }
    context.restore();
  }

  trackPath() {
    const { left, right, closed } = this.race.track;
    const path = new Path2D();
    const run = (side) => {
      for (let i = 0; i < side.length; i += 2) path[i ? "lineTo" : "moveTo"](side[i], side[i + 1]);
      if (closed) path.closePath();
    };
    run(left);
    run(right);
    return path;
  }

  drawTrail(car, colour, zoom) {
    const { context, race } = this;
    const to = Math.floor(Math.min(this.time * race.step_hz, race.last));
    const from = Math.max(0, to - Math.round(TRAIL_S * race.step_hz));
    context.strokeStyle = colour;
    context.lineWidth = (3 * this.scale) / zoom;
    for (let i = from; i < to; i++) {
      if (Math.hypot(car.x[i + 1] - car.x[i], car.y[i + 1] - car.y[i]) > JUMP_CM) continue;
      context.globalAlpha = (0.7 * (i - from + 1)) / (to - from);
      context.beginPath();
      context.moveTo(car.x[i], car.y[i]);
      context.lineTo(car.x[i + 1], car.y[i + 1]);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  drawCar(state, index, zoom) {
    const { context, colours, scale } = this;
    const size = Math.max(1, (20 * scale) / (zoom * CAR_CM[0])); // no smaller than 20 pixels
    const [length, width] = CAR_CM.map((side) => side * size);
    context.save();
    context.translate(state.x, state.y);
    context.rotate(state.yaw);
    context.globalAlpha = state.stopped ? 0.45 : 1;
    context.fillStyle = colours.cars[index];
    context.strokeStyle = colours.field;
    context.lineWidth = (1.5 * scale) / zoom;
    context.beginPath();
    context.moveTo(length / 2 + width / 3, 0);
    context.lineTo(length / 3, width / 2);
    context.lineTo(-length / 2, width / 2);
    context.lineTo(-length / 2, -width / 2);
    context.lineTo(length / 3, -width / 2);
    context.closePath();
    context.fill();
    context.stroke();
    context.rotate(-state.yaw);
    context.scale(1, -1);
    context.fillStyle = colours.field;
    context.font = `700 ${width * 0.95}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(String(index + 1), 0, width * 0.04);
    context.restore();
  }

  /** Write running order, gaps, time and caption; a few times a second is enough for reading. */
  showPanel(states, order) {
    const sought = !this.playing || this.shownAt < 0;
    const said = this.slider.matches(":focus-visible") && !sought;
    const since = this.time - this.slider.value; // below 0 the race began again
    if (!said || since < 0 || since >= SAID_S) {
      this.slider.value = this.time;
      this.slider.setAttribute("aria-valuetext", clock(this.time));
    }
    const end = clock(this.race.duration_s) + (this.race.over ? "" : " so far");
    this.clock.textContent = `${clock(this.time)} / ${end}`;
    const now = performance.now();
    if (this.playing && now - this.shownAt < 1000 / PANEL_HZ) return;
    this.shownAt = now;
    order.forEach((index, place) => {
      const { gap, lap, finished, stopped, speed } = states[index];
      const car = this.race.cars[index];
      const [mark, ...cells] = this.order.rows[place].cells;
      mark.firstChild.className = `car car-${car.number}`;
      const texts = [
        String(car.number),
        car.name,
        place ? `+${gap.toFixed(2)}` : "leader",
        finished ? "done" : `${lap}/${this.race.laps}`,
        stopped ? "penalty" : speed.toFixed(1),
      ];
      // New rows would take a screen reader's place in the table away.
      [mark.firstChild, ...cells].forEach((cell, at) => write(cell, texts[at]));
    });
    const past = this.race.events.filter((event) => event.time_s <= this.time).reverse();
    this.latest.replaceChildren(...past.slice(0, LATEST).map((event) =>
      element("li", {}, element("span", {}, clock(event.time_s)), element("span", {}, event.text)),
    ));
    if (now < this.saidUntil) return;
    const text = past.length && past[0].time_s > this.time - CAPTION_S ? past[0].text : "";
    write(this.caption, text);
  }

  /** Play or pause; "off" keeps the captions of a race that begins again and again from screen readers. */
  toggle(live = "polite") {
    this.caption.setAttribute("aria-live", live);
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "Pause" : "Play";
    if (!this.playing) return this.draw();
    if (this.over) this.time = 0;
    let before = performance.now();
    const next = (now) => {
      if (!this.playing) return;
      this.time += (Math.min(now - before, 200) / 1000) * this.speed;
      if (!this.race.over) this.time = Math.min(this.time, this.race.duration_s);
      before = now;
      if (this.over) {
        this.time = "loop" in this.root.dataset ? 0 : this.race.duration_s;
        if (this.time) {
          this.toggle();
          this.root.dispatchEvent(new CustomEvent("raceend", { bubbles: true }));
        }
      }
      this.draw();
      if (this.playing) requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.race.duration_s);
    this.shownAt = -1e9;
    this.draw();
  }

  seekToHash() {
    const match = /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash);
    if (match) this.seek(Number(match[1]));
    return Boolean(match);
  }

  /** Go to the next event, or the one before; a moment earlier, so that it is seen happening. */
  seekToEvent(direction) {
    const moments = this.race.events.map((event) => Math.max(event.time_s - LEAD_S, 0));
    const later = moments.filter((moment) => direction * (moment - this.time) > 0.05);
    if (later.length) this.seek(direction > 0 ? Math.min(...later) : Math.max(...later));
  }

  watch(number) {
    this.follow = number <= this.race.cars.length ? number : this.follow;
    this.subject.value = this.follow;
    this.draw();
  }

  fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this.root.requestFullscreen?.();
  }

  link() {
    history.replaceState(null, "", `#t=${this.time.toFixed(1)}`);
    navigator.clipboard?.writeText(location.href).catch(() => {});
    this.caption.setAttribute("aria-live", "polite");
    this.caption.textContent = "The address of this page now leads to this moment.";
    this.saidUntil = performance.now() + 1000 * CAPTION_S;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target;
    if (target.matches("select, textarea, input:not([type=range])")) return;
    if (event.key === " " && target.matches("button, a, summary")) return;
    // What has the focus elsewhere scrolls, or is pressed, with these keys itself.
    const moves = event.key === " " || event.key.length > 1;
    if (moves && target.matches("body *") && !this.root.contains(target)) return;
    const step = event.shiftKey ? 5 : 1;
    const frame = 1 / this.race.step_hz;
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(this.time - step),
      ArrowRight: () => this.seek(this.time + step),
      ",": () => this.seek(this.time - frame),
      ".": () => this.seek(this.time + frame),
      Home: () => this.seek(0),
      End: () => this.seek(this.race.duration_s),
      n: () => this.seekToEvent(1),
      p: () => this.seekToEvent(-1),
      f: () => this.fullScreen(),
    };
    const key = event.key.length > 1 ? event.key : event.key.toLowerCase();
    const action = /^\d$/.test(key) ? () => this.watch(Number(key)) : actions[key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

/** Make a player of an element with the address of a race, or with the race on the page. */
async function begin(root, plays) {
  try {
    const inline = document.getElementById("race-data");
    const answer = inline ? null : await fetch(root.dataset.replay);
    if (answer && !answer.ok) throw new Error(`The recording cannot be read (${answer.status}).`);
    const race = inline ? JSON.parse(inline.textContent) : await answer.json();
    root.player = new Player(root, race, plays || "autoplay" in root.dataset || !race.over);
    root.addEventListener("seekto", (event) => root.player.seek(event.detail));
  } catch (error) {
    root.append(element("p", { role: "alert" }, error.message));
  }
}

/** Make players of those elements that are not yet; races that come while one waits for them play. */
function beginAll(event) {
  for (const root of document.querySelectorAll("[data-replay]")) root.begun ??= begin(root, event);
}

// The window would keep players that another race has taken the place of.
function players() {
  return [...document.querySelectorAll("[data-replay].ready")].map((root) => root.player);
}

addEventListener("hashchange", () => players().forEach((player) => player.seekToHash()));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const player of players()) {
    player.readColours();
    player.draw();
  }
});
beginAll();
document.addEventListener("htmx:after:swap", beginAll);
