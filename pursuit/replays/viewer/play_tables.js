// The answers to moves in a page without a server: a duel from tables, which the rules have filled
// (see docs/live_pages.py). The user is the first agent.

function answer(state, what, content) {
  const { tables, board, frame, game } = state;
  const cells = [...frame.last];
  const own = 0, other = 1;
  const next = { ...state, warning: "", rows: [], over: false };
  const count = board.cells.length, actions = board.actions.length;

  function show(step, rewards, caught) {
    next.step = step;
    const gone = cells.map((cell, agent) => (caught && board.agents[agent].role === "evader" ? -1 : cell));
    next.frame = { ...frame, cells: gone, last: [...cells], step, rewards };
    return next;
  }

  if (what === "next") {
    next.game = game + 1;
    tables.starts[next.game % tables.starts.length].forEach((cell, agent) => (cells[agent] = cell));
    tables.start = [...cells];
    return show(0, [0, 0], false);
  }
  const pair = cells[own] * count + cells[other];
  let left = Math.random(), theirs = 0;
  while (theirs < actions - 1 && left >= tables.chances[pair][theirs]) left -= tables.chances[pair][theirs++];
  const after = tables.after[pair][content.action * actions + theirs];
  const caught = after < 0;
  if (caught) cells[own] = cells[other] = -1 - after;
  else [cells[own], cells[other]] = [Math.floor(after / count), after % count];
  show(state.step + 1, tables.rewards[Number(caught)], caught);
  next.over = caught || next.step >= board.max_steps;
  if (next.over) {
    const [from, to] = [tables.start[own], tables.start[other]];
    const won = caught === (board.agents[own].role === "chaser");
    tables.played.push([next.step, tables.values[from][to]]);
    next.rows = [
      ["you", `${next.step} steps, ${won ? "won" : "lost"}`],
      ["optimum", `${+tables.values[from][to].toFixed(2)} steps in expectation`],
    ];
    const mean = (k) => (tables.played.reduce((sum, each) => sum + each[k], 0) / tables.played.length).toFixed(2);
    if (tables.played.length > 1)
      next.total = `${tables.played.length} games; mean steps: you ${mean(0)}, optimum ${mean(1)}`;
  }
  return next;
}
