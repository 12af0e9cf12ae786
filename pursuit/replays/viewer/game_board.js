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

  // A drawing in text as a picture: a maze or a grid with a frame, numbers as cards, a field between # as squares;
  // null for other text.
  pictureOf(lines) {
    const isMaze = /^\+([- ]\+)+$/.test(lines[0]), isGrid = !isMaze && /^\+-+\+$/.test(lines[0]);
    const end = isMaze || isGrid ? lines.findLastIndex((line) => line[0] === "+") + 1 : 0, rest = lines.slice(end);
    if (!rest.every((line) => PLAIN.test(line)) || !(end || rest.some((line) => PIECES.test(line)))) return null;
    const piece = (part) => (part[0] === "#" ? make("span", {}, ...[...part.slice(1, -1)].map((mark) => make("span", { class: "square" }, mark === "." ? "" : mark))) : make("span", { class: "card" }, part));
    const words = rest.filter(Boolean).map((line) => make("p", {}, ...line.split(PIECES).map((part, place) => (place % 2 ? piece(part) : part))));
    return end ? [this.gridOf(lines.slice(0, end), isMaze), ...words] : words;
  }

  gridOf(lines, isMaze) {
    const rows = isMaze ? lines.filter((_, line) => line % 2).map((line) => [...line].filter((_, place) => place % 2)) : lines.slice(1, -1).map((line) => line.slice(1).match(/[^\s|]+/g));
    const height = rows.length, width = Math.max(...rows.map((row) => row.length)), edge = "+-".repeat(width) + "+";
    const open = rows.map((_, row) => (isMaze ? "" : `${lines[row + 1][0]}${" ".repeat(2 * width - 1)}${lines[row + 1].trimEnd().endsWith("|") ? "|" : " "}`));
    const walls = isMaze ? lines.join("\n") : [edge, ...open.flatMap((line) => [line, ""]).slice(0, -1), edge].join("\n");
    const picture = draw(null, "svg", { class: "board" });
    const { layers } = new MazeBoard(picture, { height, width, walls, cells: [], agents: [], num_goals: 0 });
    rows.forEach((row, y) => row.forEach((mark, x) => {
      if (" .#".includes(mark[0])) return;
      const seat = this.world.agents.findIndex(({ name }) => name[0].toUpperCase() === mark[0]);
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

// The probabilities of a player's legal actions in a state, with bars; the next action is bold.
// Of many actions those that are not played are left out.
function choicesTable(name, choice, next, other = "best response") {
  const row = (kind, ...parts) => make("tr", {}, ...parts.map((part, place) => make(kind, { class: place ? "number" : "" }, part)));
  const share = (part, kind) => {
    const bar = make("span", { class: `bar ${kind}` });
    bar.style.width = `${3 * part}rem`; // as an attribute it would be blocked
    return make("span", {}, bar, `${(100 * part).toFixed(1)} %`);
  };
  const few = choice.actions.length < 10, isUsed = (action, place) => few || action === next || choice.played[place] >= 0.0005 || choice.best[place] > 0;
  return make("table", {}, row("th", `${name}, next`, "played", other),
    ...choice.actions.map((action, place) => isUsed(action, place) && row("td", action === next ? make("strong", {}, action) : action,
      share(choice.played[place], "learned"), share(choice.best[place], "optimal"))).filter(Boolean));
}
