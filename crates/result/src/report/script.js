"use strict";
const gallery = document.querySelector(".gallery");
const pairs = [...gallery.querySelectorAll(".pair")];
const thumbs = document.querySelector(".thumbs");

function press(buttons, pressed) {
  for (const b of buttons) b.setAttribute("aria-pressed", String(b === pressed));
}

// The bar follows the slider; all frames share its place.
gallery.addEventListener("input", event => {
  for (const pair of pairs) {
    pair.querySelector(".compare").style.setProperty("--cut", event.target.value + "%");
    pair.querySelector("input").value = event.target.value;
  }
});

// Small pictures choose the frame.
const small = pairs.map(pair => {
  const button = document.createElement("button");
  const image = document.createElement("img");
  image.src = pair.querySelector(".input").src;
  image.alt = "frame " + pair.dataset.frame;
  button.type = "button";
  button.append(image);
  button.onclick = () => {
    for (const p of pairs) p.classList.toggle("shown", p === pair);
    press(small, button);
  };
  thumbs.append(button);
  return button;
});
press(small, small[pairs.findIndex(p => p.classList.contains("shown"))]);

// Sharp, predicted blur or depth on the right.
const kinds = [...document.querySelectorAll(".switch button")];
for (const button of kinds) {
  button.onclick = () => {
    gallery.dataset.kind = button.dataset.kind;
    for (const p of document.querySelectorAll("p.kind")) p.hidden = p.dataset.kind !== button.dataset.kind;
    press(kinds, button);
  };
}
if (!pairs.length) document.querySelector("#pictures").hidden = true;

// The map in 3D, at the frame that is shown above.
const walk = document.querySelector(".walk");
if (walk) {
  const shown = () => pairs.find(p => p.classList.contains("shown"));
  const poster = shown()?.querySelector(".sharp");
  if (poster) walk.style.backgroundImage = `url("${poster.src}")`;
  walk.querySelector("button").onclick = () => {
    const frame = document.createElement("iframe");
    frame.src = "viewer.html#frame=" + (shown()?.dataset.frame ?? 0);
    frame.title = "The map in 3D";
    frame.allow = "fullscreen";
    walk.replaceChildren(frame);
    frame.focus();
  };
}

// Values under the pointer, read back from the drawn lines.
for (const svg of document.querySelectorAll(".plot svg")) {
  const numbers = name => svg.dataset[name].split(",").map(Number);
  const [x0, x1] = numbers("x"), [y0, y1] = numbers("y");
  const [left, top, right, bottom] = numbers("box");
  const lines = [...svg.querySelectorAll("polyline")].map(line => ({
    name: line.dataset.name,
    points: [...line.points].map(p => [p.x, p.y]),
  }));
  const cursor = document.createElementNS("http://www.w3.org/2000/svg", "line");
  cursor.setAttribute("class", "cursor");
  cursor.setAttribute("y1", top);
  cursor.setAttribute("y2", bottom);
  svg.append(cursor);
  const read = document.createElement("output");
  read.className = "read";
  svg.parentNode.append(read);
  const short = v => Number(v.toPrecision(3)).toString();
  svg.addEventListener("pointermove", event => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    let column = null;
    const values = new Map();
    for (const { name, points } of lines) {
      const near = points.reduce((a, b) =>
        Math.hypot(b[0] - at.x, (b[1] - at.y) / 20) < Math.hypot(a[0] - at.x, (a[1] - at.y) / 20) ? b : a);
      if (Math.abs(near[0] - at.x) > 12) continue;
      column = near[0];
      values.set(name, short(y0 + (bottom - near[1]) / (bottom - top) * (y1 - y0)));
    }
    cursor.style.visibility = column === null ? "hidden" : "visible";
    if (column === null) { read.textContent = ""; return; }
    cursor.setAttribute("x1", column);
    cursor.setAttribute("x2", column);
    const x = short(x0 + (column - left) / (right - left) * (x1 - x0));
    read.textContent = x + ": " + [...values].map(([n, v]) => (values.size > 1 ? n + " " : "") + v).join(", ");
  });
  svg.addEventListener("pointerleave", () => {
    cursor.style.visibility = "hidden";
    read.textContent = "";
  });
}
