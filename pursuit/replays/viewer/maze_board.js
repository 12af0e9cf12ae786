// The board of a maze or a graph. A cell is a square of 10 units; the centre of cell (row, column) is
// at (10 column + 5, 10 row + 5). A graph has `neighbors`, the cell after each action.

const MOVES = [[0, -1], [0, 1], [1, 0], [-1, 0], [0, 0]]; // x and y: north, south, east, west, stay

class MazeBoard {
  constructor(element, world) {
    this.world = world;
    const width = 10 * world.width, height = 10 * world.height;
    element.setAttribute("viewBox", `-1 -1 ${width + 2} ${height + 2}`);
    draw(element, "rect", { class: "floor", width, height });
    const layer = (name) => draw(element, "g", { class: name });
    this.layers = {};
    // The nodes of a graph are filled, so their values are drawn above them.
    const cells = world.neighbors ? ["seen", "openings", "values"] : ["values", "seen", "openings"];
    this.radii = world.neighbors ? radiiOf(world.cells) : null;
    for (const name of ["blocked", "exits", ...cells, "walls", "trails", "arrows", "labels", "goals", "agents"]) {
      this.layers[name] = layer(name);
    }
    if (world.neighbors) this.drawGraph(world);
    else this.drawMaze(world);
    for (const cell of world.exits || []) {
      const [x, y] = this.middle(cell);
      draw(this.layers.exits, "rect", { x: x - 5, y: y - 5, width: 10, height: 10 });
    }
    this.squares = null;
    this.arrows = null;
    this.goals = Array.from({ length: world.num_goals }, () => token(this.layers.goals, "goal", ""));
    const many = (role) => world.agents.filter((agent) => agent.role === role).length > 1;
    this.agents = world.agents.map((agent) =>
      token(this.layers.agents, agent.role, many(agent.role) ? agent.name.split("_").pop() : ""));
    this.tour = draw(this.layers.trails, "polyline", { class: "trail tour", transform: "translate(1.1 1.1)" });
    this.trails = world.agents.map((agent) => draw(this.layers.trails, "polyline", { class: `trail ${agent.role}` }));
  }

  drawMaze(world) {
    const lines = world.walls.split("\n");
    const at = (line, column) => (lines[line] || "")[column] || " ";
    const walls = [], openings = [];
    for (let line = 0; line < 2 * world.height + 1; line++) {
      for (let column = 0; column < 2 * world.width + 1; column++) {
        const x = 5 * column, y = 5 * line;
        if (line % 2 === 1 && column % 2 === 1) {
          if (at(line, column) === "#") draw(this.layers.blocked, "rect", { x: x - 5, y: y - 5, width: 10, height: 10 });
        } else if (line % 2 === 1 || column % 2 === 1) {
          const path = line % 2 === 0 ? `M${x - 5} ${y}h10` : `M${x} ${y - 5}v10`;
          (at(line, column) === " " ? openings : walls).push(path);
        }
      }
    }
    draw(this.layers.openings, "path", { d: openings.join("") });
    draw(this.layers.walls, "path", { d: walls.join("") });
  }

  drawGraph(world) {
    world.neighbors.forEach((row, cell) => row.forEach((there, action) => {
      if (there === cell) return;
      const [x, y] = this.middle(cell), [toX, toY] = this.middle(there);
      draw(this.layers.openings, "path", { class: "edge", d: `M${x} ${y}L${toX} ${toY}` });
      if (!world.neighbors[there].includes(cell)) {
        const [dx, dy] = this.direction(cell, action);
        const tipX = toX - this.radii[there] * dx, tipY = toY - this.radii[there] * dy;
        const points = [[0, 0], [-2.4, 1.2], [-2.4, -1.2]].map(([along, across]) =>
          `${(tipX + along * dx - across * dy).toFixed(2)},${(tipY + along * dy + across * dx).toFixed(2)}`);
        draw(this.layers.walls, "polygon", { class: "one-way", points: points.join(" ") });
      }
    }));
    world.cells.forEach((_, cell) => {
      const [cx, cy] = this.middle(cell);
      draw(this.layers.openings, "circle", { class: "node", cx, cy, r: this.radii[cell] });
    });
  }

  // The direction of an action on the screen, x and y.
  direction(cell, action) {
    if (!this.world.neighbors) return MOVES[action];
    const there = (this.world.neighbors[cell] || [])[action];
    const [x, y] = this.middle(cell), [toX, toY] = this.middle(there);
    const length = Math.hypot(toX - x, toY - y);
    return length > 0 ? [(toX - x) / length, (toY - y) / length] : [0, 0];
  }

  middle(cell) {
    const [row, column] = this.world.cells[cell];
    return [10 * column + 5, 10 * row + 5];
  }

  // frame: {cells: [cell, or -1 of agents that have left the game], last: [the same with their last
  // cell], goals: [cell or -1]}; extras: {trails: [[cells]], tour: [cells], values, arrows, seen}
  show(frame, extras) {
    const together = new Map();
    frame.cells.forEach((cell) => together.set(cell, (together.get(cell) || 0) + 1));
    const taken = new Map();
    frame.cells.forEach((cell, number) => {
      const gone = cell < 0;
      const [x, y] = this.middle(frame.last[number]);
      const count = together.get(cell), turn = taken.get(cell) || 0;
      taken.set(cell, turn + 1);
      const aside = !gone && count > 1 ? 2.2 * Math.cos((2 * Math.PI * turn) / count) : 0;
      const down = !gone && count > 1 ? 2.2 * Math.sin((2 * Math.PI * turn) / count) : 0;
      const scale = !gone && count > 1 ? " scale(0.7)" : "";
      place(this.agents[number], {
        visibility: "visible",
        transform: `translate(${(x + aside).toFixed(2)} ${(y + down).toFixed(2)})${scale}`,
      });
      this.agents[number].classList.toggle("gone", gone);
    });
    this.goals.forEach((goal, number) => {
      const cell = frame.goals[number];
      if (cell === undefined || cell < 0) return place(goal, { visibility: "hidden" });
      const [x, y] = this.middle(cell);
      place(goal, { visibility: "visible", transform: `translate(${x} ${y})` });
    });
    const points = (cells = []) => cells.map((cell) => this.middle(cell).join(",")).join(" ");
    this.trails.forEach((trail, number) => place(trail, { points: points((extras.trails || [])[number]) }));
    place(this.tour, { points: points(extras.tour) });
    this.showValues(extras.values || null);
    this.showArrows(extras.arrows || null);
    this.showSeen(extras.seen || null);
  }

  // values: {numbers: [value of every cell], low, high}
  showValues(values) {
    for (const layer of [this.layers.values, this.layers.labels]) {
      layer.setAttribute("visibility", values ? "visible" : "hidden");
    }
    if (!values) return;
    if (!this.squares) {
      this.squares = this.world.cells.map((_, cell) => {
        const [x, y] = this.middle(cell);
        if (this.radii) {
          const r = this.radii[cell], circle = draw(this.layers.values, "circle", { cx: x, cy: y, r });
          const text = draw(this.layers.labels, "text", { class: "inside", x, y });
          text.style.fontSize = `${0.65 * r}px`; // as an attribute it would be blocked
          return [circle, text];
        }
        const square = draw(this.layers.values, "rect", { x: x - 5, y: y - 5, width: 10, height: 10 });
        return [square, draw(this.layers.labels, "text", { x: x - 4.3, y: y - 2.2 })];
      });
    }
    const span = Math.max(values.high - values.low, 1e-9);
    values.numbers.forEach((value, cell) => {
      const [square, text] = this.squares[cell];
      const known = Number.isFinite(value);
      const label = known ? value.toFixed(value >= 9.95 ? 0 : values.high < 1 ? 2 : 1) : "";
      place(square, { fill: known ? shade((value - values.low) / span) : "none" });
      if (text.textContent !== label) text.textContent = label;
    });
  }

  // arrows: {learned: [[action probabilities] or null per cell], optimal: [action bits per cell]}
  showArrows(arrows) {
    this.layers.arrows.setAttribute("visibility", arrows ? "visible" : "hidden");
    if (!arrows) return;
    if (!this.arrows) {
      this.arrows = this.world.cells.map((_, cell) => {
        const [x, y] = this.middle(cell);
        const differs = draw(this.layers.arrows, "rect", { class: "differs", x: x - 4.4, y: y - 4.4, width: 8.8, height: 8.8 });
        const optimal = draw(this.layers.arrows, "path", { class: "optimal" });
        const learned = draw(this.layers.arrows, "path", { class: "learned" });
        return { differs, optimal, learned };
      });
    }
    this.world.cells.forEach((_, cell) => {
      const marks = this.arrows[cell], [x, y] = this.middle(cell);
      const bits = arrows.optimal ? arrows.optimal[cell] : 0;
      const chances = arrows.learned ? arrows.learned[cell] : null;
      const drawn = (action, length, side) => {
        const [dx, dy] = this.direction(cell, action), r = this.radii ? this.radii[cell] : 0; // beside the number
        return r ? arrow(x + r * dx, y + (dx || dy ? r * dy : r + 1), [dx, dy], length, side) : arrow(x + 0.7, y + 1.1, [dx, dy], length, side);
      };
      place(marks.optimal, { d: [...Array(32).keys()].map((action) => (bits >> action) & 1 ? drawn(action, 3.4, 1) : "").join("") });
      let best = -1;
      if (chances) chances.forEach((chance, action) => { if (best < 0 || chance > chances[best]) best = action; });
      place(marks.learned, {
        d: best < 0 ? "" : drawn(best, 2.8, -1),
        opacity: best < 0 ? 0 : (0.35 + 0.65 * chances[best]).toFixed(2),
      });
      const wrong = best >= 0 && bits > 0 && !((bits >> best) & 1);
      place(marks.differs, { visibility: wrong ? "inherit" : "hidden" });
    });
  }

  // seen: [[plane, cell], ...], the observation of the selected agent
  showSeen(seen) {
    this.layers.seen.replaceChildren();
    for (const [plane, cell] of seen || []) {
      const [x, y] = this.middle(cell);
      draw(this.layers.seen, "rect", { class: `plane plane-${plane === 5 ? "view" : plane % 4}`, x: x - 4.6, y: y - 4.6, width: 9.2, height: 9.2 });
    }
  }
}

// The radius of every node, so that no two circles overlap (unless nodes are at almost one place).
function radiiOf(cells) {
  const nearby = new Map(); // the nodes in each square of 0.7 cells, which is the largest diameter
  const square = (row, column) => `${row},${column}`;
  const at = ([row, column]) => [Math.floor(row / 0.7), Math.floor(column / 0.7)];
  cells.forEach((cell, number) => {
    const key = square(...at(cell));
    nearby.set(key, [...(nearby.get(key) || []), number]);
  });
  return cells.map((cell, number) => {
    const [row, column] = at(cell);
    let radius = 0.35;
    for (const down of [-1, 0, 1]) for (const right of [-1, 0, 1]) {
      for (const other of nearby.get(square(row + down, column + right)) || []) {
        const away = Math.hypot(cell[0] - cells[other][0], cell[1] - cells[other][1]);
        if (other !== number) radius = Math.min(radius, 0.48 * away);
      }
    }
    return Math.max(10 * radius, 0.3);
  });
}

// An arrow from a point, or a dot for waiting; optimal and learned ones are drawn on opposite sides.
function arrow(x, y, [dx, dy], length, side) {
  if (!dx && !dy) return `M${x + 1.3 * side - 0.4} ${y}a.4 .4 0 1 0 .8 0a.4 .4 0 1 0 -.8 0`;
  const aside = 0.9 * side, ax = x - dy * aside, ay = y + dx * aside;
  const tx = ax + dx * length, ty = ay + dy * length;
  return `M${ax} ${ay}L${tx} ${ty}M${tx - 1.3 * dx - 1.1 * dy} ${ty - 1.3 * dy - 1.1 * dx}L${tx} ${ty}` +
    `L${tx - 1.3 * dx + 1.1 * dy} ${ty - 1.3 * dy + 1.1 * dx}`;
}

// The colour map cividis, readable for colour-blind users: dark blue (few steps) to yellow (many).
const CIVIDIS = [[0, 34, 78], [66, 78, 108], [123, 124, 120], [186, 173, 108], [254, 232, 56]];

// The colours from `low` to `high`, as a legend.
function scale(low, high) {
  return make("span", { class: "scale" }, low, make("span", { class: "colors" }), high);
}

function shade(share) {
  const at = Math.min(Math.max(share, 0), 1) * (CIVIDIS.length - 1);
  const low = Math.min(Math.floor(at), CIVIDIS.length - 2), rest = at - low;
  return `rgb(${CIVIDIS[low].map((part, i) => Math.round(part + rest * (CIVIDIS[low + 1][i] - part))).join(",")})`;
}
