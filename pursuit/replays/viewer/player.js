// The player of one episode, or of several side by side. Its data is in the element "pursuit-data"
// (see pursuit/replays/viewer/data.py).

const TRAIL = 24; // steps shown in a trail
const DUELS = "known for one chaser and one evader with known probabilities, in one maze of up to 225 cells";
const HELP = [
  ["space", "play, pause"], ["← →", "one step back, forward (with shift ten)"], ["home end", "first, last step"],
  ["↑ ↓", "previous, next episode"], ["0 … 9", "speed: 1 is one step per second, each higher number doubles it, 0 is the maximum"],
  ["b", "all episodes side by side, or one"], ["c", "the optimal agent from the same start, beside the played one"], ["t", "trails"], ["v", "exact value of every cell, for the selected agent"],
  ["p", "moves of the played policy (solid) and optimal ones (dashed)"], ["o", "observation of the learner"], ["d", "dark, light"], ["?", "this list"],
];

function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

function bytes(text) {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}

// An episode; `frame(step)` is the state that boards show.
class Episode {
  constructor(item, worlds) {
    Object.assign(this, item);
    this.world = worlds[item.world];
    this.length = item.length;
    this.beside = item.beside && new Episode(item.beside, worlds); // of the optimal agent from the same start
  }

  frame(step) {
    if (this.world.kind === "arm") {
      return { angles: this.angles[step], target: this.target, step };
    }
    if (this.world.kind === "game") {
      return { state: this.states[step], ended: this.terminated && step === this.length && !this.shows_end, step };
    }
    const isGone = this.gone.map((at) => at !== null && step >= at);
    const cells = this.cells.map((path, agent) => (isGone[agent] ? -1 : path[step]));
    const last = this.cells.map((path) => path[step]);
    const goals = this.goals.map(([cell, gone]) => (gone !== null && step >= gone ? -1 : cell));
    return { cells, last, goals, escaped: this.escaped, step };
  }

  // [reward of the last step, return so far] of every agent.
  rewardsAt(step) {
    return this.rewards.map((row) => {
      let sum = 0;
      for (let i = 0; i < step; i++) sum += row[i];
      return [step > 0 ? row[step - 1] : null, sum];
    });
  }

  // The path of the optimal agent from the same start, of an agent alone: then it depends on nothing else.
  get tour() {
    const { angles, cells } = this.beside || {};
    return angles || (cells && cells.length === 1 && cells[0]) || [];
  }

  count(step, agent, kind) {
    return this.events.filter(([at, actor, event]) => at <= step && actor === agent && event === kind).length;
  }

  ending(step) {
    if (step < this.length) return "";
    const how = this.terminated ? "terminated" : this.truncated ? "truncated" : "unfinished";
    return `(${[how, this.outcome].filter(Boolean).join(": ")})`;
  }
}

// Exact values and policies of one agent of a duel, by its own cell and the opponent's cell.
class Overlay {
  constructor(given) {
    Object.assign(this, given);
    this.values = given.values ? new Float32Array(bytes(given.values).buffer) : null;
    this.learned = given.learned ? bytes(given.learned) : null;
    this.optimal = given.optimal ? new Uint32Array(bytes(given.optimal).buffer) : null;
    if (this.values) {
      this.low = this.values.reduce((a, b) => (b > 0 && b < a ? b : a), Infinity);
      this.high = this.values.reduce((a, b) => Math.max(a, b), 0);
    }
  }

  valuesAt(other) {
    const numbers = Array.from({ length: this.cells }, (_, own) => (own === other ? NaN : this.values[own * this.cells + other]));
    return { numbers, low: this.low, high: this.high };
  }

  // The probabilities of the actions of `choicesTable`; optimal ones are equally probable.
  choiceAt(own, other, { neighbors, names }) {
    const { learned, optimal } = this.arrowsAt(other), best = learned[own].map((_, action) => (optimal[own] >> action) & 1);
    const sum = best.reduce((a, b) => a + b, 0);
    const actions = learned[own].map((_, action) => (neighbors ? names[neighbors[own][action]] : ["north", "south", "east", "west", "stay"][action]));
    return { actions, played: learned[own], best: best.map((bit) => bit / (sum || 1)) };
  }

  arrowsAt(other) {
    const range = Array.from({ length: this.cells }, (_, own) => own);
    const optimal = this.optimal && range.map((own) => (own === other ? 0 : this.optimal[own * this.cells + other]));
    const learned = this.learned && range.map((own) => {
      if (own === other) return null;
      const at = (own * this.cells + other) * this.actions;
      return Array.from(this.learned.subarray(at, at + this.actions), (part) => part / 255);
    });
    return { optimal, learned };
  }
}

class Player {
  constructor(root, data) {
    this.root = root;
    this.episodes = data.items.map((item) => new Episode(item, data.worlds));
    this.overlays = (data.overlays || []).map((given) => new Overlay(given));
    const lost = (number) => this.episodes[number].lost || 0, length = (number) => this.episodes[number].length;
    this.chosen = [...this.episodes.keys()].sort((a, b) => lost(b) - lost(a) || length(b) - length(a))[0]; // the longest if unknown
    this.step = 0;
    this.speed = 3;
    this.playing = false;
    this.several = false;
    this.shown = { trails: true, values: true, policy: true, seen: false, beside: true };
    this.side = 0;
    this.build();
    this.lay();
    document.addEventListener("keydown", (event) => this.key(event));
    if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) this.play(true);
  }

  get episode() { return this.episodes[this.chosen]; }

  get length() { return Math.max(...this.boards.map(({ episode }) => episode.length)); }

  sides(episode = this.episode) { return (episode.overlays || []).map((number) => this.overlays[number]); }

  // The state of the viewer, for tests and notebooks.
  state() {
    const frame = this.episode.frame(Math.min(this.step, this.episode.length));
    return { episode: this.chosen, playing: this.playing, speed: this.speed, several: this.several, length: this.length, shown: { ...this.shown }, ...frame, step: this.step };
  }

  build() {
    const button = (label, title, action) => make("button", { type: "button", title, "aria-label": title, onclick: action }, label);
    const toggle = (label, key, title, action) => make("button", { type: "button", title: `${title} (${key})`, "aria-pressed": "false", onclick: action }, label);
    this.buttons = {
      play: button("play", "play (space)", () => this.play(!this.playing)),
      trails: toggle("trails", "t", "trails", () => this.toggle("trails")),
      values: toggle("values", "v", "exact value of every cell", () => this.toggle("values")),
      policy: toggle("policy", "p", "moves of the played policy and optimal ones", () => this.toggle("policy")),
      seen: toggle("observed", "o", "observation of the learner", () => this.toggle("seen")),
      beside: toggle("beside optimal", "c", "the optimal agent from the same start, beside the played one", () => this.toggle("beside")),
      several: toggle("all episodes", "b", "all episodes side by side", () => this.lay(!this.several)),
    };
    this.bar = make("input", { type: "range", min: 0, step: 1, value: 0, "aria-label": "step", oninput: () => this.go(Number(this.bar.value)) });
    this.clock = make("output", {});
    this.pace = make("select", { "aria-label": "speed", onchange: () => this.setSpeed(Number(this.pace.value)) },
      ...Array.from({ length: 10 }, (_, speed) => make("option", { value: speed }, speed ? `${2 ** (speed - 1)}/s` : "fastest")));
    this.choice = make("div", { class: "row episodes", role: "group", "aria-label": "episode" },
      ...this.episodes.map((episode, number) => make("button", { type: "button", onclick: () => this.choose(number) }, episode.name)));
    this.sideChoice = make("select", { "aria-label": "agent", onchange: () => { this.side = Number(this.sideChoice.value); this.show(); } });
    this.stage = make("div", { class: "stage" });
    this.score = make("div", { class: "wide" });
    this.numbers = make("div", { class: "numbers" });
    this.note = make("p", { class: "faint" });
    this.why = make("p", { class: "faint why" });
    this.legend = make("div", { class: "legend" });
    this.spoken = make("p", { class: "faint", "aria-live": "polite" });
    this.map = make("figure", { class: "map" });
    const games = this.episodes.every((episode) => episode.world.kind === "game");
    this.help = make("dialog", {}, make("h2", {}, "Keys"),
      make("table", {}, ...HELP.filter(([keys]) => !games || !"tvpo".includes(keys)).map(([keys, what]) => make("tr", {}, make("td", {}, make("kbd", {}, keys)), make("td", {}, what)))),
      make("form", { method: "dialog" }, make("button", {}, "close")));
    const controls = make("div", { class: "controls" },
      button("«", "first step (home)", () => this.go(0)), button("‹", "one step back (left)", () => this.go(this.step - 1)),
      this.buttons.play, button("›", "one step forward (right)", () => this.go(this.step + 1)), button("»", "last step (end)", () => this.go(this.length)),
      this.bar, this.clock, this.pace);
    const side = make("div", { class: "side" }, this.choice, this.note,
      make("div", { class: "row" }, this.buttons.trails, this.buttons.values, this.buttons.policy, this.buttons.seen, this.sideChoice),
      this.why, this.score, this.legend, this.numbers, this.spoken);
    const view = make("div", { class: "row controls" }, this.buttons.beside, this.buttons.several,
      button("dark / light", "dark or light (d)", () => this.theme()), button("keys", "keys (?)", () => this.help.showModal()));
    this.frame = make("section", { class: "player", "aria-label": "player" }, controls, view, this.stage, side, this.map, this.help);
    view.classList.add("view");
    this.root.append(this.frame);
  }

  // Create the boards of the episodes that are shown.
  lay(several = this.several) {
    this.several = several && this.episodes.length > 1;
    this.frame.classList.toggle("several", this.several);
    const shown = this.several ? this.episodes : [this.episode, this.shown.beside && this.episode.beside].filter(Boolean);
    this.frame.classList.toggle("pair", !this.several && shown.length > 1);
    this.boards = shown.map((episode) => {
      const picture = episode.world.kind === "game" ? make("div") : document.createElementNS(SVG, "svg");
      const caption = make("figcaption");
      this.stage.append(make("figure", {}, picture, caption));
      return { episode, picture, caption, board: new Board(picture, episode.world) };
    });
    this.stage.replaceChildren(...this.boards.map(({ picture }) => picture.parentElement));
    const sides = this.sides();
    this.side = Math.min(this.side, Math.max(sides.length - 1, 0));
    this.sideChoice.replaceChildren(...sides.map((side, number) => make("option", { value: number }, `agent: ${side.name}`)));
    this.sideChoice.value = String(this.side);
    this.sideChoice.hidden = sides.length < 2;
    this.buttons.several.hidden = this.episodes.length < 2;
    this.buttons.beside.disabled = !this.episode.beside;
    this.choice.hidden = this.episodes.length < 2;
    this.buttons.values.disabled = !sides.some((side) => side.values);
    this.buttons.policy.disabled = !sides.some((side) => side.learned || side.optimal);
    this.buttons.seen.disabled = !(this.episode.seen || this.episode.observed);
    this.sideChoice.parentElement.hidden = this.episode.world.kind === "game";
    this.explain();
    [...this.choice.children].forEach((button, number) => button.setAttribute("aria-pressed", String(number === this.chosen)));
    const { note = "", lost, length, beside } = this.episode;
    const compared = lost === undefined ? "" : `Steps lost: ${lost} (${length} steps, ${beside.by} ${beside.length}, from the same start).`;
    this.note.textContent = `${note} ${compared}`.trim();
    this.showMap(this.episode.map, { ...this.episode.world, agents: [], num_goals: 0 });
    this.bar.max = String(this.length);
    this.go(Math.min(this.step, this.length));
  }

  // Why buttons are grey: as their titles, and as text for users without a mouse.
  explain() {
    const alone = this.episode.alone || "in reports of one learner whose optimum is known";
    const reasons = { values: DUELS, policy: DUELS, seen: "in reports of runs in mazes", beside: alone };
    const names = new Map(); // by reason
    for (const [name, reason] of Object.entries(reasons)) {
      const button = this.buttons[name];
      button.dataset.title ||= button.title;
      button.title = button.disabled ? reason : button.dataset.title;
      if (button.disabled && !button.parentElement.hidden) names.set(reason, [...(names.get(reason) || []), button.textContent]);
    }
    this.why.textContent = [...names].map(([reason, buttons]) => `Not here: ${buttons.join(", ")} (${reason}).`).join(" ");
  }

  // numbers: [mean steps lost, or null, per start cell]
  showMap(numbers, world) {
    this.map.hidden = !numbers;
    if (!numbers) return;
    const picture = document.createElementNS(SVG, "svg"), high = Math.max(...numbers);
    new Board(picture, world).inner.showValues({ numbers, low: 0, high });
    const legend = scale("0", high.toFixed(2));
    this.map.replaceChildren(make("figcaption", {}, "Mean steps lost to the optimum, by the learner's start cell: ", legend), picture);
  }

  choose(number) {
    this.chosen = (number + this.episodes.length) % this.episodes.length;
    this.step = 0;
    this.lay(false);
  }

  go(step) {
    this.step = Math.min(Math.max(Math.round(step), 0), this.length);
    if (this.step >= this.length && this.playing) this.play(false);
    this.show();
  }

  setSpeed(speed) {
    this.speed = speed;
    this.pace.value = String(speed);
  }

  toggle(what) {
    if (this.buttons[what].disabled) return;
    this.shown[what] = !this.shown[what];
    if (what === "beside") this.lay(false);
    else this.show();
  }

  theme() {
    const dark = document.documentElement.dataset.theme
      ? document.documentElement.dataset.theme === "dark"
      : window.matchMedia("(prefers-color-scheme: dark)").matches;
    document.documentElement.dataset.theme = dark ? "light" : "dark";
  }

  play(on) {
    if (on && this.step >= this.length) this.step = 0;
    this.playing = on;
    this.buttons.play.textContent = on ? "pause" : "play";
    this.buttons.play.setAttribute("aria-label", on ? "pause (space)" : "play (space)");
    cancelAnimationFrame(this.ticking);
    if (on) {
      let last = null, due = 0;
      const tick = (now) => {
        if (!this.playing) return;
        due += this.speed === 0 ? 1 : last === null ? 0 : ((now - last) / 1000) * 2 ** (this.speed - 1);
        last = now;
        const steps = Math.floor(due);
        if (steps > 0) {
          due -= steps;
          this.go(this.step + steps);
        }
        this.ticking = requestAnimationFrame(tick);
      };
      this.ticking = requestAnimationFrame(tick);
    }
    this.show();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.help.open) return;
    const target = event.target, typing = target.closest && target.closest("select, textarea, input:not([type=range])");
    if (typing) return;
    const stride = event.shiftKey ? 10 : 1;
    const actions = {
      " ": () => this.play(!this.playing), ArrowLeft: () => this.go(this.step - stride), ArrowRight: () => this.go(this.step + stride),
      Home: () => this.go(0), End: () => this.go(this.length),
      ArrowUp: () => this.choose(this.chosen - 1), ArrowDown: () => this.choose(this.chosen + 1),
      t: () => this.toggle("trails"), v: () => this.toggle("values"), p: () => this.toggle("policy"), o: () => this.toggle("seen"),
      b: () => this.lay(!this.several), c: () => this.toggle("beside"), d: () => this.theme(), "?": () => this.help.showModal(),
    };
    if (event.key.startsWith("Arrow") && (event.key === "ArrowUp" || event.key === "ArrowDown") && this.episodes.length < 2) return;
    const action = actions[event.key] || (/^[0-9]$/.test(event.key) && (() => this.setSpeed(Number(event.key))));
    if (!action) return;
    if (event.key === " " && target.tagName === "BUTTON") target.blur();
    event.preventDefault();
    action();
  }

  show() {
    for (const { episode, board, caption, picture } of this.boards) {
      const step = Math.min(this.step, episode.length), frame = episode.frame(step);
      board.show(frame, this.extras(episode, frame, step));
      caption.textContent = frame.ended ? "The game has ended; this is the state before its last step." : "";
      const name = this.several ? episode.name : episode.by || episode.name;
      if (this.boards.length > 1) caption.textContent = `${name}: step ${step} of ${episode.length} ${episode.ending(step)} ${caption.textContent}`;
      picture.setAttribute("aria-label", `${name}, step ${step}`);
    }
    this.bar.value = String(this.step);
    this.clock.textContent = `step ${this.step} of ${this.length}${this.boards.length > 1 ? "" : ` ${this.episode.ending(this.step)}`}`;
    this.pace.value = String(this.speed);
    for (const name of ["trails", "values", "policy", "seen", "beside"]) {
      this.buttons[name].setAttribute("aria-pressed", String(this.shown[name] && !this.buttons[name].disabled));
    }
    this.buttons.several.setAttribute("aria-pressed", String(this.several));
    if (!this.several) this.showNumbers();
  }

  extras(episode, frame, step) {
    if (episode.world.kind === "game") return {};
    const tour = this.shown.trails ? episode.tour : [], first = tour.length ? 0 : Math.max(0, step - TRAIL);
    if (episode.world.kind === "arm") return { tour, trail: this.shown.trails ? episode.angles.slice(first, step + 1) : [] };
    const until = episode.cells.map((path, agent) => (episode.gone[agent] === null ? step : Math.min(step, episode.gone[agent])));
    const extras = {
      tour, trails: this.shown.trails ? episode.cells.map((path, agent) => path.slice(first, until[agent] + 1)) : [],
    };
    const isBeside = !this.several && episode !== this.episode; // its values are those of the learner
    const side = isBeside && this.side ? null : this.sides(episode)[this.several ? 0 : this.side];
    const other = side ? frame.cells[side.other] : -1;
    if (side && other >= 0 && step < episode.length) {
      if (this.shown.values && side.values) extras.values = side.valuesAt(other);
      if (this.shown.policy) extras.arrows = { ...side.arrowsAt(other), ...(isBeside && { learned: null }) };
    }
    if (this.shown.seen && episode.seen) extras.seen = episode.seen.steps[step];
    return extras;
  }

  // The table and texts next to the board.
  showNumbers() {
    const { episode } = this, step = Math.min(this.step, episode.length);
    const row = (...parts) => make("tr", {}, ...parts);
    const number = (value) => make("td", { class: "number" }, value === null ? "" : Number(value.toFixed(3)).toString());
    const { kind } = episode.world, head = ["", "reward", "return"], arm = kind === "arm", game = kind === "game";
    const goals = episode.world.num_goals > 0, pursued = !arm && !game && episode.world.agents.some((agent) => agent.role === "chaser");
    if (goals) head.push("goals");
    if (pursued) head.push("captures");
    if (game && episode.values) head.push("value");
    if (game) head.push("action");
    const names = arm ? ["arm"] : episode.world.agents.map((agent) => agent.name);
    const rewards = episode.rewardsAt(step);
    this.score.replaceChildren(make("table", {}, row(...head.map((text) => make("th", { class: text && text !== "action" ? "number" : "" }, text))),
      ...names.map((name, agent) => {
        const cells = [make("td", { title: episode.players[agent] || "" }, name), number(rewards[agent][0]), number(rewards[agent][1])];
        if (goals) cells.push(number(episode.count(step, agent, "collected")));
        if (pursued) cells.push(number(episode.count(step, agent, "captured")));
        if (game && episode.values) cells.push(number(episode.values[step][agent]));
        if (game) cells.push(make("td", {}, step ? episode.actions[step - 1][agent] : ""));
        return row(...cells);
      })));
    if (game && step < episode.length) {
      const { choices } = episode.world.states[episode.states[step]];
      const tables = choices.map((choice, agent) => choicesTable(names[agent], choice, episode.actions[step][agent]));
      this.score.append(...tables.filter((_, agent) => choices[agent].actions.length > 1)); // not of those who wait
    }
    const side = this.sides()[this.side], frame = episode.frame(step);
    const [own, other] = side ? [frame.cells[side.seat], frame.cells[side.other]] : [];
    if (side && this.shown.policy && side.learned && side.optimal && own >= 0 && other >= 0) {
      this.score.append(choicesTable(side.name, side.choiceAt(own, other, episode.world), null, "optimal"));
    }
    const parts = game ? [episode.world.legend] : [];
    const players = names.map((name, agent) => episode.players[agent] && `${name} is ${episode.players[agent]}`).filter(Boolean);
    if (players.length) parts.push(`${players.join(", ")}.`);
    if (episode.world.exits) parts.push("Evaders that have left the game are dashed.");
    if (side && (this.shown.values || this.shown.policy)) parts.push(`Values and moves of ${side.name} in each cell, exact from the start of an episode.`);
    if (this.shown.seen && episode.seen) parts.push(`Observation of ${episode.seen.agent}: ${episode.seen.names.join(", ")}.`);
    this.legend.replaceChildren(...this.signs(episode, side), make("p", {}, parts.join(" ")));
    const observed = this.shown.seen && episode.observed;
    this.numbers.textContent = observed ? `${observed.encoding}: ${observed.steps[step].join(" ")}` : "";
    this.spoken.textContent = this.playing ? "" : this.words(frame);
  }

  // The signs of the board and their meanings; side: the overlay that is shown, if any.
  signs(episode, side) {
    const { world, tour, beside, by, length } = episode, arm = world.kind === "arm", { trails, values, policy } = this.shown;
    const roles = world.kind === "maze" ? [...new Set(world.agents.map((agent) => agent.role)), ...(world.num_goals ? ["goal"] : [])] : [];
    const line = (name, d) => (into) => draw(draw(into, "g", { class: "arrows" }), "path", { class: name, d });
    const ahead = arrow(-3, 0, [1, 0], 6, 0), learned = side && policy && side.learned;
    return [
      ...roles.map((role) => sign((into) => token(into, role, ""), role)),
      world.exits && sign((into) => draw(draw(into, "g", { class: "exits" }), "rect", { x: -4, y: -4, width: 8, height: 8 }), "exit"),
      arm && sign((into) => draw(into, "circle", { class: "tip", r: 3 }), "tip"),
      arm && sign((into) => draw(into, "circle", { class: "target", r: 4 }), "target"),
      trails && tour.length && sign((into) => draw(into, "polyline", { class: "trail tour", points: "-5,0 5,0" }),
        `path of the ${beside.by} agent, ${beside.length} steps; that of ${by} has ${length}`),
      learned && sign(line("learned", ahead), "played move, the most probable"),
      side && policy && sign(line("optimal", ahead), "optimal moves"),
      side && policy && sign(line("learned", arrow(0, 0, [0, 0], 0, 0)), "waits"),
      learned && side.optimal && sign(line("differs", "M-4 -4h8v8h-8z"), "not optimal"),
      side && values && side.values && make("span", { class: "sign" }, scale(side.low.toFixed(1), side.high.toFixed(1)), " steps until capture"),
    ].filter(Boolean);
  }

  words(frame) {
    if (this.episode.world.kind === "game") return `step ${frame.step}: ${this.episode.world.states[frame.state].text}`;
    if (frame.angles) return `step ${frame.step}: target at ${frame.target.map((part) => part.toFixed(2)).join(", ")}`;
    const { names, cells } = this.episode.world;
    const gone = (number) => ((frame.escaped || [])[number] ? "escaped" : "captured");
    const where = (cell, number) => (cell < 0 ? gone(number) : names ? `at ${names[cell]}` : `row ${cells[cell][0] + 1}, column ${cells[cell][1] + 1}`);
    return `step ${frame.step}: ${this.episode.world.agents.map((agent, number) => `${agent.name} ${where(frame.cells[number], number)}`).join("; ")}`;
  }
}

const pursuitRoot = document.getElementById("pursuit");
const pursuitData = document.getElementById("pursuit-data");
if (pursuitRoot && pursuitData && pursuitRoot.dataset.mode !== "play") {
  window.pursuit = new Player(pursuitRoot, JSON.parse(pursuitData.textContent));
}
