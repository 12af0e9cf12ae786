// The page of `pursuit play`: sends moves from keys and touches to the server and shows its answers.
// The first state is in the element "pursuit-data" (see train/play/server.py). In a page without a
// server, `answer` of play_tables.js answers.

(function () {
  const WAIT = 110; // ms between two moves while a key is pressed
  const MAZE_KEYS = {
    ArrowUp: 0, w: 0, ArrowDown: 1, s: 1, ArrowRight: 2, d: 2, ArrowLeft: 3, a: 3, " ": 4,
  };
  const SIGNS = ["▲", "▼", "▶", "◀", "■"]; // of the actions, in order of their numbers
  const TRAIL = 12; // steps shown in a trail

  function make(kind, into, text, name) {
    const node = document.createElement(kind);
    if (text) node.textContent = text;
    if (name) node.className = name;
    into.append(node);
    return node;
  }

  function start(state) {
    const place = document.getElementById("pursuit");
    place.className = "play";
    const agentTitle = make("h1", place), title = make("p", place, "", "faint");
    const drawing = draw(place, "svg");
    const status = make("p", place);
    status.setAttribute("role", "status");
    const buttons = make("div", place, "", "keys");
    const result = make("div", place, "", "result");
    result.setAttribute("aria-live", "polite");
    const next = make("button", place, "next game (n)");
    const help = make("p", place, "", "faint");
    let board = null, world = null, busy = false, last = 0, past = [];

    function show(answer) {
      const changed = answer.board && JSON.stringify(answer.board) !== JSON.stringify(world);
      state = answer;
      if (changed) {
        world = answer.board;
        drawing.replaceChildren();
        board = new Board(drawing, world);
        board.inner.agents[world.you].classList.add("own");
        prepare();
      }
      if (answer.title) title.textContent = answer.title;
      agentTitle.textContent = `You are ${world.agents[world.you].name}`;
      if (!past.length || past[0].game !== state.game || past.length !== state.step) past = [];
      past.push({ game: state.game, ...state.frame });
      board.show(state.frame, trails());
      drawing.setAttribute("aria-label", description());
      const reward = state.frame.rewards[world.you];
      status.textContent =
        `game ${state.game + 1}, step ${state.step} / ${world.max_steps}, reward ${+reward.toFixed(3)}`;
      result.replaceChildren();
      if (state.over) {
        const table = make("table", result);
        for (const [name, value] of state.rows) {
          const row = make("tr", table);
          make("td", row, name);
          make("td", row, value);
        }
      }
      if (state.total) make("p", result, state.total);
      if (state.warning) make("p", result, "warning: " + state.warning);
    }

    // The state as text.
    function description() {
      const gone = (n) => ((state.frame.escaped || [])[n] ? "escaped" : "captured");
      const at = (cell, n) => (cell < 0 ? gone(n) : `row ${world.cells[cell][0]} column ${world.cells[cell][1]}`);
      const agents = world.agents.map((agent, n) => `${agent.name} ${at(state.frame.cells[n], n)}`);
      const goals = state.frame.goals.filter((goal) => goal >= 0).map((goal) => `goal ${at(goal)}`);
      return [...agents, ...goals].join(", ");
    }

    // The recent cells of all agents.
    function trails() {
      const some = past.slice(-TRAIL);
      return { trails: world.agents.map((_, n) => some.map((frame) => frame.last[n])) };
    }

    async function asked(what, content) {
      const answer = await fetch(what, {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(content),
      });
      return answer.json();
    }

    async function send(what, content) {
      if (busy) return;
      busy = true;
      last = performance.now();
      try {
        const reply = state.tables ? answer(state, what, content) : await asked(what, content);
        if (reply.frame) show(reply); // also after a refused move
        else status.textContent = reply.error;
      } catch (error) {
        status.textContent = "The server does not answer; start pursuit play again.";
      }
      busy = false;
    }

    function move(action) {
      if (!state.over) send("move", { game: state.game, step: state.step, action });
    }

    function begin() {
      send("next", { game: state.game });
    }

    function prepare() {
      buttons.replaceChildren();
      const cross = make("div", buttons, "", "cross");
      const places = { 0: [1, 2], 3: [2, 1], 4: [2, 2], 2: [2, 3], 1: [3, 2] };
      for (const number of [0, 3, 4, 2, 1]) {
        if (number >= world.actions.length) continue;
        const node = make("button", cross, SIGNS[number]);
        node.setAttribute("aria-label", world.actions[number]);
        node.addEventListener("click", () => move(number));
        node.style.gridArea = `${places[number][0]} / ${places[number][1]}`;
      }
      const stays = world.actions.length > 4 ? "space to stay" : "move into a wall to stay";
      const exits = world.exits ? " Green cells are exits; evaders that have left the game are dashed." : "";
      help.textContent = `Arrow keys or w, a, s, d to move; ${stays}; n for the next game.${exits}`;
    }

    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const pressed = document.activeElement && document.activeElement.tagName === "BUTTON";
      if (key === " " && pressed) return; // activates the focused button
      if (key === "n") {
        if (!event.repeat) begin();
        return;
      }
      const soon = event.repeat && performance.now() - last < WAIT;
      const number = MAZE_KEYS[key];
      if (number === undefined || number >= world.actions.length) return;
      if (!soon) move(number);
      event.preventDefault(); // no scrolling
    });
    next.addEventListener("click", begin);
    show(state);
  }

  start(JSON.parse(document.getElementById("pursuit-data").textContent));
})();
