"use strict";
(() => {
  const tip = document.createElement("div");
  tip.id = "tip";
  tip.hidden = true;
  document.body.append(tip);
  const say = (text, event) => {
    tip.textContent = text;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    const left = Math.min(event.clientX + 14, innerWidth - box.width - 6);
    const above = event.clientY - box.height - 12;
    tip.style.left = Math.max(4, left) + "px";
    tip.style.top = (above > 4 ? above : event.clientY + 18) + "px";
  };
  const hush = () => { tip.hidden = true; };
  addEventListener("scroll", hush, { passive: true });
  // A box that scrolls is reached by the keys as well.
  const boxes = document.querySelectorAll(".wide,.scroll");
  const reach = () => { for (const box of boxes) if (box.scrollWidth > box.clientWidth) box.tabIndex = 0; else box.removeAttribute("tabindex"); };
  addEventListener("resize", reach);
  reach();
  const numbers = (text) => text.trim().split(/[\s,]+/).map(Number);
  const shown = (value, range) => {
    const digits = Math.max(0, Math.min(6, 4 - Math.ceil(Math.log10(Math.abs(range) || 1))));
    return value.toFixed(digits).replace("-", "\u2212");
  };
  const inside = (svg, event) => {
    const matrix = svg.getScreenCTM();
    return matrix && new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
  };
  for (const svg of document.querySelectorAll("svg.xy")) {
    const [x0, x1, u0, u1] = numbers(svg.dataset.x);
    const [y0, y1, v0, v1] = numbers(svg.dataset.y);
    let all = null;
    const ring = svg.querySelector("g.at");
    svg.addEventListener("pointermove", (event) => {
      const at = inside(svg, event);
      if (!at) return;
      if (!all) {
        all = [];
        for (const series of svg.querySelectorAll("g.s")) {
          const flat = numbers(series.querySelector("polyline").getAttribute("points"));
          for (let i = 0; i + 1 < flat.length; i += 2) all.push([flat[i], flat[i + 1], series.dataset.n]);
        }
      }
      let best = null, least = 30 * 30;
      for (const point of all) {
        const far = (point[0] - at.x) ** 2 + (point[1] - at.y) ** 2;
        if (far < least) { least = far; best = point; }
      }
      ring.textContent = "";
      if (!best) return hush();
      const circle = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      circle.setAttribute("cx", best[0]);
      circle.setAttribute("cy", best[1]);
      circle.setAttribute("r", 6);
      ring.append(circle);
      const x = u0 + (best[0] - x0) / (x1 - x0) * (u1 - u0);
      const y = v0 + (best[1] - y0) / (y1 - y0) * (v1 - v0);
      say(best[2] + "\n" + svg.dataset.l + ": " + shown(x, u1 - u0) + "\n" + svg.dataset.m + ": " + shown(y, v1 - v0), event);
    });
    svg.addEventListener("pointerleave", () => { ring.textContent = ""; hush(); });
  }
  for (const svg of document.querySelectorAll("svg.heat")) {
    let chosen = null;
    svg.addEventListener("pointermove", (event) => {
      if (chosen) chosen.classList.remove("chosen");
      chosen = event.target.closest("rect");
      if (!chosen) return hush();
      chosen.classList.add("chosen");
      say(chosen.dataset.v + " " + svg.dataset.u, event);
    });
    svg.addEventListener("pointerleave", () => { if (chosen) chosen.classList.remove("chosen"); hush(); });
  }
  for (const svg of document.querySelectorAll("svg.quiver")) {
    let [turn, tilt] = numbers(svg.dataset.view);
    const [width, height, scale] = numbers(svg.dataset.size);
    // Vectors have sizes and a path of dots, the edges of the box have none.
    const sets = [...svg.querySelectorAll("path[data-p]")].map((path) => ({
      path, p: numbers(path.dataset.p), sizes: numbers(path.dataset.v || ""), root: path.dataset.v && path.nextElementSibling,
    }));
    const names = [...svg.querySelectorAll("text[data-p]")].map((name) => ({ name, p: numbers(name.dataset.p) }));
    // Without a graphics card Chromium turns a thousand paths 30 times a second, and a canvas 60 times. Paper gets the paths.
    const stage = document.createElement("div");
    const canvas = document.createElement("canvas");
    stage.className = "stage";
    canvas.setAttribute("aria-hidden", "true");
    svg.replaceWith(stage);
    stage.append(svg, canvas);
    const pen = canvas.getContext("2d");
    let least = 0, zoom = 1, onPaper = false;
    const draw = () => {
      const st = Math.sin(turn), ct = Math.cos(turn), si = Math.sin(tilt), ci = Math.cos(tilt);
      const place = (x, y, z) => [
        width / 2 + (x * ct - y * st) * scale,
        height / 2 - (z * ci + (x * st + y * ct) * si) * scale,
      ];
      if (onPaper) {
        for (const { path, p, root } of sets) {
          let lines = "", dots = "";
          for (let i = 0; i < p.length; i += 6) {
            const from = "M" + place(p[i], p[i + 1], p[i + 2]).map((at) => at.toFixed(2)).join(" ");
            lines += from + "L" + place(p[i + 3], p[i + 4], p[i + 5]).map((at) => at.toFixed(2)).join(" ");
            dots += from + "h0";
          }
          path.setAttribute("d", lines);
          if (root) root.setAttribute("d", dots);
        }
        for (const { name, p } of names) ["x", "y"].forEach((key, i) => name.setAttribute(key, place(...p)[i]));
        return;
      }
      const scaled = (x, y, z) => place(x, y, z).map((at) => zoom * at);
      pen.clearRect(0, 0, canvas.width, canvas.height);
      for (const { p, sizes, root, style } of sets) {
        pen.strokeStyle = pen.fillStyle = style.stroke;
        pen.globalAlpha = style.opacity;
        pen.lineWidth = parseFloat(style.strokeWidth);
        pen.beginPath();
        for (let i = 0; i < p.length; i += 6) {
          if (root && sizes[i / 6] < least) continue;
          const [x, y] = scaled(p[i], p[i + 1], p[i + 2]);
          if (root) pen.fillRect(x - 1.5, y - 1.5, 3, 3);
          pen.moveTo(x, y);
          pen.lineTo(...scaled(p[i + 3], p[i + 4], p[i + 5]));
        }
        pen.stroke();
      }
      pen.globalAlpha = 1;
      for (const { name, p, style } of names) {
        pen.fillStyle = style.fill;
        pen.font = `${style.fontWeight} ${zoom * parseFloat(style.fontSize)}px ${style.fontFamily}`;
        pen.fillText(name.textContent, ...scaled(...p));
      }
    };
    const turned = (by, up) => {
      turn += by;
      tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, tilt + up));
      draw();
    };
    const level = svg.closest(".keep").querySelector(".level");
    const slider = level.querySelector("input");
    const vectors = sets.flatMap(({ sizes, root }) => root ? sizes : []);
    const filter = () => {
      least = Number(slider.value);
      draw();
      const text = slider.value + " \u00b5m";
      slider.setAttribute("aria-valuetext", text);
      level.querySelector("output").textContent = text + ": " + vectors.filter((um) => um >= least).length + " of " + vectors.length;
    };
    // On paper there is no slider, so every vector is drawn.
    for (const [event, paper] of [["beforeprint", true], ["afterprint", false]]) addEventListener(event, () => { onPaper = paper; draw(); });
    // A frame that reads the layout or the colours waits for them.
    const fit = () => {
      const box = svg.getBoundingClientRect();
      zoom = box.width / width;
      for (const side of ["width", "height"]) {
        canvas[side] = Math.round(box[side] * devicePixelRatio);
        canvas.style[side] = box[side] + "px";
      }
      pen.scale(devicePixelRatio, devicePixelRatio);
      pen.textAlign = "center";
      for (const part of [...sets, ...names]) part.style = getComputedStyle(part.path || part.name);
      draw();
    };
    new ResizeObserver(fit).observe(svg);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", fit);
    slider.addEventListener("input", filter);
    fit();
    filter();
    level.hidden = false;
    let last = null;
    svg.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      if (!last) return;
      turned(-(event.clientX - last[0]) / 160, (event.clientY - last[1]) / 160);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { last = null; });
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (!step) return;
      event.preventDefault();
      turned(step[0], step[1]);
    });
  }
})();
