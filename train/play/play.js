"use strict";
/* The page of a game by hand: keys and touches become moves, the server decides, Board draws. */

(function () {
  const WAIT = 110; // ms between two moves while a key is held
  const MAZE_KEYS = {
    ArrowUp: 0, w: 0, ArrowDown: 1, s: 1, ArrowRight: 2, d: 2, ArrowLeft: 3, a: 3, " ": 4,
  };
  const SIGNS = ["▲", "▼", "▶", "◀", "■"]; // of the actions, in the rule book's order
  const FORTH = "qwertyui", BACK = "asdfghjk"; // a key for each joint of an arm

  const style = document.createElement("style");
  style.textContent = `
    .play { max-width: 44rem; margin: 0 auto; padding: .5rem; }
    .play svg { display: block; width: 100%; max-height: 62vh; touch-action: manipulation; }
    .play .status { font-variant-numeric: tabular-nums; }
    .play .keys { display: flex; flex-wrap: wrap; gap: .5rem; margin: .5rem 0; }
    .play button { font: inherit; min-width: 3.2rem; min-height: 3.2rem; touch-action: manipulation;
      user-select: none; -webkit-user-select: none; }
    .play .cross { display: grid; grid-template-columns: repeat(3, 3.6rem); gap: .3rem; }
    .play .cross button { width: 100%; }
    .play table { border-collapse: collapse; }
    .play td { padding: .1rem 1rem .1rem 0; }
    .play .help { opacity: .75; }`;
  document.head.append(style);

  function make(kind, into, text, name) {
    const node = document.createElement(kind);
    if (text) node.textContent = text;
    if (name) node.className = name;
    into.append(node);
    return node;
  }

  function start(state) {
    const place = make("main", document.body, "", "play");
    const title = make("h1", place);
    const drawing = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    drawing.setAttribute("role", "img");
    place.append(drawing);
    const status = make("p", place, "", "status");
    status.setAttribute("role", "status");
    const buttons = make("div", place, "", "keys");
    const result = make("div", place, "", "result");
    result.setAttribute("aria-live", "polite");
    const next = make("button", place, "next game (n)");
    const help = make("p", place, "", "help");
    const held = new Set(); // turns of an arm that go on: [joint, sign] as text
    let board = null, world = null, busy = false, last = 0;

    function show(fresh) {
      const other = fresh.board && JSON.stringify(fresh.board) !== JSON.stringify(world);
      state = fresh;
      if (other) {
        world = fresh.board;
        drawing.replaceChildren();
        board = new Board(drawing, world);
        prepare();
      }
      if (fresh.title) title.textContent = fresh.title;
      board.show(state.frame);
      const paid = state.frame.rewards ? state.frame.rewards[world.you] : state.frame.reward;
      status.textContent =
        `game ${state.game + 1}, step ${state.step} / ${world.max_steps}, reward ${+paid.toFixed(3)}`;
      result.replaceChildren();
      if (state.over) {
        const table = make("table", result);
        for (const [who, what] of state.rows) {
          const row = make("tr", table);
          make("td", row, who);
          make("td", row, what);
        }
      }
      if (state.total) make("p", result, state.total);
      if (state.warning) make("p", result, "warning: " + state.warning);
    }

    async function send(what, content) {
      if (busy) return;
      busy = true;
      last = performance.now();
      try {
        const answer = await fetch(what, {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify(content),
        });
        const told = await answer.json();
        if (told.frame) show(told); // also where it was out of turn: that is how it stands
        else status.textContent = told.error;
      } catch (error) {
        held.clear();
        status.textContent = "nobody answers: pursuit play has ended. Start it again";
      }
      busy = false;
    }

    function move(action) {
      if (!state.over) send("move", { game: state.game, step: state.step, action });
    }

    function begin() {
      send("next", { game: state.game });
    }

    function turn(only) {
      const action = new Array(world.joints).fill(0);
      for (const each of only || held) {
        const [joint, sign] = each.split(",").map(Number);
        action[joint] += sign;
      }
      move(action);
    }

    function button(into, text, label, press, release) {
      const node = make("button", into, text);
      node.setAttribute("aria-label", label);
      if (release) {
        node.addEventListener("pointerdown", press);
        for (const end of ["pointerup", "pointerleave", "pointercancel"])
          node.addEventListener(end, release);
        node.addEventListener("click", (event) => { // by keyboard, or a reader of the screen
          if (event.detail === 0) turn([label]);
        });
      } else {
        node.addEventListener("click", press);
      }
      return node;
    }

    function prepare() {
      buttons.replaceChildren();
      held.clear();
      if (world.kind === "arm") {
        for (let joint = 0; joint < world.joints; joint++)
          for (const [sign, text] of [[1, "↺"], [-1, "↻"]]) {
            const what = joint + "," + sign;
            const node = button(buttons, `${joint + 1} ${text}`, what,
              () => { held.add(what); turn(); }, () => held.delete(what));
            node.setAttribute("aria-label",
              `joint ${joint + 1} ${sign > 0 ? "left" : "right"}`);
          }
        const n = world.joints;
        help.textContent = `Hold ${FORTH.slice(0, n).split("").join(", ")} to turn a joint to the ` +
          `left, ${BACK.slice(0, n).split("").join(", ")} to the right, several at once; space ` +
          "waits; n begins the next game.";
      } else {
        const cross = make("div", buttons, "", "cross");
        const places = { 0: [1, 2], 3: [2, 1], 4: [2, 2], 2: [2, 3], 1: [3, 2] };
        for (const number of [0, 3, 4, 2, 1]) {
          if (number >= world.actions.length) continue;
          const node = button(cross, SIGNS[number], world.actions[number], () => move(number));
          node.style.gridArea = `${places[number][0]} / ${places[number][1]}`;
        }
        const stays = world.actions.length > 4 ? "space stays" : "a move into a wall waits";
        help.textContent = `You are ${world.agents[world.you].name}. Arrow keys or w, a, s, d; ` +
          `${stays}; n begins the next game.`;
      }
    }

    function joint_of(key) {
      for (const [keys, sign] of [[FORTH, 1], [BACK, -1]]) {
        const joint = keys.indexOf(key);
        if (key.length === 1 && joint >= 0 && joint < world.joints) return joint + "," + sign;
      }
      return null;
    }

    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const pressed = document.activeElement && document.activeElement.tagName === "BUTTON";
      if (key === " " && pressed) return; // it presses the button that has the focus
      if (key === "n") {
        if (!event.repeat) begin();
        return;
      }
      const soon = event.repeat && performance.now() - last < WAIT;
      if (world.kind === "arm") {
        const what = joint_of(key);
        if (what && !event.repeat) { held.add(what); turn(); }
        else if (key === " " && !soon) turn([]);
        else if (!what) return;
      } else {
        const number = MAZE_KEYS[key];
        if (number === undefined || number >= world.actions.length) return;
        if (!soon) move(number);
      }
      event.preventDefault(); // the page does not scroll
    });
    document.addEventListener("keyup", (event) => {
      const what = world.kind === "arm" && joint_of(event.key.toLowerCase());
      if (what) held.delete(what);
    });
    window.addEventListener("blur", () => held.clear());
    setInterval(() => {
      if (held.size && performance.now() - last >= WAIT) turn();
    }, WAIT / 4);
    next.addEventListener("click", begin);
    show(state);
  }

  start(JSON.parse(document.getElementById("data").textContent));
})();
