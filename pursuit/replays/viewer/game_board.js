// The board of a small game: the drawing of a state. SVG is shown as an image, in which browsers run
// no scripts and load nothing; an image needs the namespace, which SVG in a page may leave out.
const NAMED = `<svg xmlns="${SVG}"`;

const ROLES = ["chaser", "evader", "runner"]; // the shapes and colours of players, in their order
const PLAIN = /^[\w\s:;,.#-]*$/, PIECES = /(#\S*#|\b\d+\b)/; // lines of words, with fields and numbers

class GameBoard {
  constructor(element, world) {
    this.world = world;
    this.text = make("pre");
    this.image = make("img");
    this.drawn = make("div");
    element.append(this.text, this.image, this.drawn);
  }

  // The parts of a picture of text: a maze or a grid with a frame, numbers as cards, a field between # as
  // squares; null for other text.
  pictureOf(lines) {
    const isMaze = /^\+([- ]\+)+$/.test(lines[0]), hasFrame = isMaze || /^\+-+\+$/.test(lines[0]);
    const end = hasFrame ? lines.findLastIndex((line) => line[0] === "+") + 1 : 0, rest = lines.slice(end).filter(Boolean);
    const cells = isMaze
      ? lines.slice(0, end).filter((_, line) => line % 2).map((line) => [...line].filter((_, place) => place % 2))
      : lines.slice(1, Math.max(end - 1, 1)).map((line) => line.slice(1).match(/[^\s|]+/g) || []);
    const isGrid = cells.length > 0 && cells.every((row) => row.length && (isMaze || row.length === cells[0].length));
    if (!rest.every((line) => PLAIN.test(line)) || !(hasFrame ? isGrid : rest.some((line) => PIECES.test(line)))) return null;
    const square = (mark) => make("span", { class: "square" }, mark === "." ? "" : mark);
    const piece = (part) => (part[0] === "#" ? make("span", {}, ...[...part.slice(1, -1)].map(square)) : make("span", { class: "card" }, part));
    const words = rest.map((line) => make("p", {}, ...line.split(PIECES).map((part, place) => (place % 2 ? piece(part) : part))));
    return hasFrame ? [this.gridOf(cells, isMaze ? lines.slice(0, end) : framed(lines.slice(1, end - 1), cells[0].length)), ...words] : words;
  }

  // cells: [rows][columns] marks; walls: the lines of a maze
  gridOf(cells, walls) {
    const picture = draw(null, "svg", { class: "board" }), width = Math.max(...cells.map((row) => row.length));
    const { layers } = new MazeBoard(picture, { height: cells.length, width, walls: walls.join("\n"), cells: [], agents: [], num_goals: 0 });
    cells.forEach((row, y) => row.forEach((mark, x) => {
      if (" .#".includes(mark[0])) return;
      const seat = this.world.agents.findIndex(({ name }) => name.charAt(0).toUpperCase() === mark[0]);
      const group = seat < 0 ? draw(layers.agents, "g", { class: "mark" }) : token(layers.agents, ROLES[seat % 3], mark[0]);
      if (seat < 0) draw(group, "text", { y: 1.4 }, mark);
      if (mark.includes("*")) draw(group, "circle", { class: "ball", cx: 3, cy: 2.6, r: 1.4 });
      group.setAttribute("transform", `translate(${10 * x + 5} ${10 * y + 5})`);
    }));
    return picture;
  }

  // frame: {state}, a number in world.states
  show(frame) {
    const { text, drawing } = this.world.states[frame.state], isPicture = drawing.trimStart().startsWith("<svg");
    const parts = isPicture || drawing === text ? null : this.pictureOf(drawing.trimEnd().split("\n"));
    this.text.hidden = isPicture || Boolean(parts);
    this.image.hidden = !isPicture;
    this.drawn.replaceChildren(...(parts || []));
    if (!isPicture) this.text.textContent = drawing;
    else {
      const complete = drawing.includes("xmlns=") ? drawing.trimStart() : drawing.replace("<svg", NAMED);
      place(this.image, { src: `data:image/svg+xml,${encodeURIComponent(complete)}`, alt: text });
    }
  }
}

// The lines of a maze without inner walls, open at the sides where the rows of a frame are.
function framed(rows, width) {
  const edge = `+${"-+".repeat(width)}`, side = (mark) => (mark === "|" ? "|" : " ");
  return [edge, ...rows.flatMap((row) => [`${side(row[0])}${" ".repeat(2 * width - 1)}${side(row.trimEnd().slice(1).slice(-1))}`, ""]).slice(0, -1), edge];
}

// The probabilities of a player's legal actions in a state, with bars; the next action is bold.
// Of many actions those that are not played are left out.
function choicesTable(name, choice, next, other = "best response") {
  const row = (kind, ...parts) => make("tr", {}, ...parts.map((part, place) => make(kind, { class: place ? "number" : "" }, part)));
  const share = (part, kind) => {
    const bar = make("span", { class: `bar ${kind}` });
    bar.style.width = `${1.6 * part}rem`; // as an attribute it would be blocked
    return make("span", {}, bar, `${(100 * part).toFixed(1)} %`);
  };
  const isPlayed = (place) => choice.played[place] >= 0.0005 || choice.best[place] > 0;
  const isUsed = (action, place) => choice.actions.length < 10 || action === next || isPlayed(place);
  return make("table", {}, row("th", `${name}, next`, "played", other),
    ...choice.actions.map((action, place) => isUsed(action, place) && row("td", action === next ? make("strong", {}, action) : action,
      share(choice.played[place], "learned"), share(choice.best[place], "optimal"))).filter(Boolean));
}
