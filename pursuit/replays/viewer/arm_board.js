// The board of an arm. A link has length 10, the base is at (0, 0), and y points up.

class ArmBoard {
  constructor(element, world) {
    this.world = world;
    const rim = 10 * world.joints + 10 * Math.min(world.tolerance, 1) + 3;
    element.setAttribute("viewBox", `${-rim} ${-rim} ${2 * rim} ${2 * rim}`);
    draw(element, "circle", { class: "rim", r: 10 * world.joints });
    this.target = draw(element, "circle", { class: "target", r: 10 * world.tolerance });
    this.middle = draw(element, "path", { class: "target-middle" });
    this.tour = draw(element, "polyline", { class: "trail tour" });
    this.trail = draw(element, "polyline", { class: "trail tip" });
    this.links = draw(element, "polyline", { class: "links" });
    this.joints = Array.from({ length: world.joints }, () => draw(element, "circle", { class: "joint", r: 1.6 }));
    this.tip = draw(element, "circle", { class: "tip", r: 1.9 });
  }

  ends(angles) {
    let direction = 0, x = 0, y = 0;
    const points = [[0, 0]];
    for (const angle of angles) {
      direction += angle;
      x += 10 * Math.cos(direction);
      y -= 10 * Math.sin(direction);
      points.push([x, y]);
    }
    return points;
  }

  // frame: {angles, target}; extras: {trail: [angles of earlier steps], tour: [angles]}
  show(frame, extras) {
    const text = (points) => points.map((point) => point.map((part) => part.toFixed(2)).join(",")).join(" ");
    const points = this.ends(frame.angles), [x, y] = [10 * frame.target[0], -10 * frame.target[1]];
    place(this.links, { points: text(points) });
    this.joints.forEach((joint, number) => place(joint, { cx: points[number][0], cy: points[number][1] }));
    const [tx, ty] = points[points.length - 1];
    place(this.tip, { cx: tx, cy: ty });
    place(this.target, { cx: x, cy: y });
    place(this.middle, { d: `M${x - 1} ${y}h2M${x} ${y - 1}v2` });
    const reached = Math.hypot(tx - x, ty - y) <= 10 * this.world.tolerance;
    this.target.classList.toggle("reached", reached);
    const tips = (poses = []) => text(poses.map((angles) => this.ends(angles).pop()));
    place(this.trail, { points: tips(extras.trail) });
    place(this.tour, { points: tips(extras.tour) });
  }
}
