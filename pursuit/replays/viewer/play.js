// The page of a game by hand: keys and touches become moves, the server decides, a board draws. What
// it begins with stands in the element "pursuit-data" (see train/play/server.py).

(function () {
  const WAIT = 110; // ms between two moves while a key is held
  const MAZE_KEYS = {
    ArrowUp: 0, w: 0, ArrowDown: 1, s: 1, ArrowRight: 2, d: 2, ArrowLeft: 3, a: 3, " ": 4,
  };
  const SIGNS = ["▲", "▼", "▶", "◀", "■"]; // of the actions, in the rule book's order
  const TRAIL = 12; // steps that a trail shows

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
    const who = make("h1", place), title = make("p", place, "", "faint");
    const drawing = draw(place, "svg");
    const status = make("p", place);
    status.setAttribute("role", "status");
    const buttons = make("div", place, "", "keys");
    const result = make("div", place, "", "result");
    result.setAttribute("aria-live", "polite");
    const next = make("button", place, "next game (n)");
    const help = make("p", place, "", "faint");
    let board = null, world = null, busy = false, last = 0, past = [];

    function show(fresh) {
      const other = fresh.board && JSON.stringify(fresh.board) !== JSON.stringify(world);
      state = fresh;
      if (other) {
        world = fresh.board;
        drawing.replaceChildren();
        board = new Board(drawing, world);
        board.inner.agents[world.you].classList.add("own");
        prepare();
      }
      if (fresh.title) title.textContent = fresh.title;
      who.textContent = `You are ${world.agents[world.you].name}`;
      if (!past.length || past[0].game !== state.game || past.length !== state.step) past = [];
      past.push({ game: state.game, ...state.frame });
      board.show(state.frame, trails());
      drawing.setAttribute("aria-label", told());
      const paid = state.frame.rewards[world.you];
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

    // The moment in words.
    function told() {
      const at = (cell) => (cell < 0 ? "gone" : `row ${world.cells[cell][0]} column ${world.cells[cell][1]}`);
      const agents = world.agents.map((agent, n) => `${agent.name} ${at(state.frame.cells[n])}`);
      const goals = state.frame.goals.filter((goal) => goal >= 0).map((goal) => `goal ${at(goal)}`);
      return [...agents, ...goals].join(", ");
    }

    // Where everybody was, and of who is gone where it was last.
    function trails() {
      const some = past.slice(-TRAIL);
      const of = (number) => past.map((frame) => frame.cells[number]).filter((cell) => cell >= 0);
      return {
        trails: world.agents.map((_, n) => some.map((f) => f.cells[n]).filter((cell) => cell >= 0)),
        last: world.agents.map((_, n) => of(n).pop()),
      };
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
      const stays = world.actions.length > 4 ? "space stays" : "a move into a wall waits";
      help.textContent = `Arrow keys or w, a, s, d; ${stays}; n begins the next game.`;
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
      const number = MAZE_KEYS[key];
      if (number === undefined || number >= world.actions.length) return;
      if (!soon) move(number);
      event.preventDefault(); // the page does not scroll
    });
    next.addEventListener("click", begin);
    show(state);
  }

  start(JSON.parse(document.getElementById("pursuit-data").textContent));
})();
