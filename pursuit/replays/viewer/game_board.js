// The board of a small game: the drawing of a state. SVG is shown as an image, in which browsers run
// no scripts and load nothing; an image needs the namespace, which SVG in a page may leave out.
const NAMED = `<svg xmlns="${SVG}"`;

class GameBoard {
  constructor(element, world) {
    this.world = world;
    this.text = make("pre");
    this.image = make("img");
    element.append(this.text, this.image);
  }

  // frame: {state}, a number in world.states
  show(frame) {
    const { text, drawing } = this.world.states[frame.state], isPicture = drawing.trimStart().startsWith("<svg");
    this.text.hidden = isPicture;
    this.image.hidden = !isPicture;
    if (!isPicture) this.text.textContent = drawing;
    else {
      const complete = drawing.includes("xmlns=") ? drawing.trimStart() : drawing.replace("<svg", NAMED);
      place(this.image, { src: `data:image/svg+xml,${encodeURIComponent(complete)}`, alt: text });
    }
  }
}

// The probabilities of a player's legal actions in a state; the next action is bold.
function choicesTable(name, choice, next) {
  const row = (kind, ...parts) => make("tr", {}, ...parts.map((part, place) => make(kind, { class: place ? "number" : "" }, part)));
  const share = (part) => `${(100 * part).toFixed(1)} %`;
  return make("table", {}, row("th", `${name}, next`, "played", "best response"),
    ...choice.actions.map((action, place) => row("td", action === next ? make("strong", {}, action) : action,
      share(choice.played[place]), share(choice.best[place]))));
}
