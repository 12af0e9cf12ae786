"use strict";
// A board is an SVG picture of one state. `new Board(element, world)` draws the static parts,
// `board.show(frame, extras)` updates the others.

const SVG = "http://www.w3.org/2000/svg";

function draw(parent, name, attributes = {}, text = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== null) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

// Set attributes that differ; browsers repaint after every assignment, even of an equal value.
function place(element, attributes) {
  for (const [key, value] of Object.entries(attributes)) {
    const text = String(value);
    if (element.getAttribute(key) !== text) element.setAttribute(key, text);
  }
}

function corners(count, radius, inner = null) {
  const points = [];
  const total = inner === null ? count : 2 * count;
  for (let i = 0; i < total; i++) {
    const angle = (2 * Math.PI * i) / total - Math.PI / 2;
    const reach = inner !== null && i % 2 ? inner : radius;
    points.push(`${(reach * Math.cos(angle)).toFixed(2)},${(reach * Math.sin(angle)).toFixed(2)}`);
  }
  return points.join(" ");
}

// Roles differ in shape as well as in colour, for readers who cannot distinguish the colours.
const SHAPES = {
  chaser: (parent) => draw(parent, "polygon", { points: corners(3, 4.2), transform: "translate(0 0.9)" }),
  evader: (parent) => draw(parent, "circle", { r: 3.2 }),
  runner: (parent) => draw(parent, "rect", { x: -2.9, y: -2.9, width: 5.8, height: 5.8 }),
  goal: (parent) => draw(parent, "polygon", { points: corners(5, 3.6, 1.6) }),
};

function token(parent, role, label) {
  const group = draw(parent, "g", { class: `token ${role}` });
  SHAPES[role](group);
  if (label) draw(group, "text", { class: "label", y: role === "chaser" ? 2.9 : 1.4 }, label);
  return group;
}

// A sign of a board and its meaning, for legends; `paint` draws into a picture from -5 to 5.
function sign(paint, ...meaning) {
  const picture = draw(null, "svg", { class: "swatch", viewBox: "-5 -5 10 10", "aria-hidden": "true" });
  paint(picture);
  return make("span", { class: "sign" }, picture, ...meaning);
}

class Board {
  constructor(element, world) {
    const kind = { maze: MazeBoard, arm: ArmBoard, game: GameBoard }[world.kind];
    element.replaceChildren();
    element.classList.add("board");
    element.setAttribute("role", "img");
    this.inner = new kind(element, world);
  }

  show(frame, extras = {}) {
    this.inner.show(frame, extras);
  }
}
