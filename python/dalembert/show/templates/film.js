"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const get = (id) => document.getElementById(id);
  const [film, play, place, clock] = ["film", "play", "place", "clock"].map(get);
  const last = data.frames.length - 1;
  const filled = ["plane", "body"];
  const widths = {ground: 1, plane: 1, body: 1.5, bar: 1.7, blade: 4, velocity: 1.8, reaction: 2.2};
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let colours = {}, now = 0, began = null, from = 0;

  // Of a film in a page the frame says whether this is dark; elsewhere it is what is preferred.
  const readColours = () => {
    const root = document.documentElement;
    const around = frameElement ? getComputedStyle(frameElement).colorScheme : "";
    const chosen = around === "light" || around === "dark";
    root.classList.toggle("dark", chosen ? around === "dark" : dark.matches);
    const style = getComputedStyle(root);
    for (const name of [...data.roles, "trail", "ink", "quiet", "rule"])
      colours[name] = style.getPropertyValue("--" + name);
  };

  // A canvas with as many pixels as the screen has; the size is in those of CSS.
  const clear = (canvas) => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    pen.lineJoin = "round";
    return [pen, width, height];
  };

  const drawFilm = () => {
    const [pen, width, height] = clear(film), [w, h] = data.size;
    const below = data.grid.length ? 18 : 0;
    const unit = Math.min(width / w, (height - below) / h);
    const left = (width - unit * w) / 2, low = (height - below + unit * h) / 2;
    const x = (a) => left + unit * a, y = (b) => low - unit * b;
    const path = (points, first, count) => {
      pen.beginPath();
      for (let i = first; i < count; i += 2) pen.lineTo(x(points[i]), y(points[i + 1]));
    };
    const stroke = (role, wide) => {
      pen.strokeStyle = colours[role];
      pen.lineWidth = wide;
      pen.stroke();
    };
    const shape = (points) => {
      const role = data.roles[points[0]];
      if (role === "dot") {
        pen.beginPath();
        pen.arc(x(points[1]), y(points[2]), 2.6, 0, 7);
        pen.fillStyle = colours.dot;
        pen.fill();
        return;
      }
      path(points, 1, points.length);
      if (filled.includes(role)) {
        pen.closePath();
        pen.fillStyle = colours[role];
        pen.globalAlpha = 0.2;
        pen.fill();
        pen.globalAlpha = 1;
      }
      stroke(role, widths[role]);
    };
    pen.fillStyle = colours.quiet;
    for (const [axis, at, text] of data.grid) {
      path(axis ? [0, at, w, at] : [at, 0, at, h], 0, 4);
      stroke("rule", 1);
      pen.textAlign = axis ? "left" : "center";
      if (axis) pen.fillText(text, x(0) + 2, y(at) - 3);
      else pen.fillText(text, x(at), y(0) + 14);
    }
    const [right, up] = data.names;
    pen.textAlign = "right";
    if (right) pen.fillText(right, x(w) - 4, y(0) - 4);
    pen.textAlign = "left";
    if (up) pen.fillText(up, x(0) + 30, y(h) + 12);
    data.ground.forEach(shape);
    for (const trail of data.trails) {
      path(trail, 0, 2 * (now * data.each + 1));
      stroke("trail", 1.2);
    }
    data.frames[now].forEach(shape);
  };

  const drawCurve = (canvas, curve) => {
    const [pen, width, height] = clear(canvas), points = curve.points;
    const [t0, t1] = [data.t[0], data.t[last]];
    const values = points.map((point) => point[1]);
    if (curve.bound !== null) values.push(curve.bound);
    let [low, high] = [Math.min(...values), Math.max(...values)];
    if (!(high > low)) [low, high] = [low - 1, high + 1];
    const x = (t) => 62 + (width - 70) * (t1 === t0 ? 0 : (t - t0) / (t1 - t0));
    const y = (v) => height - 8 - (height - 32) * (v - low) / (high - low);
    const line = (ends, role, wide) => {
      pen.beginPath();
      ends.forEach(([a, b]) => pen.lineTo(a, b));
      pen.strokeStyle = colours[role];
      pen.lineWidth = wide;
      pen.stroke();
    };
    pen.fillStyle = colours.ink;
    const room = width - pen.measureText(curve.name).width;
    pen.fillText(curve.name, Math.max(0, Math.min(62, room)), 12);
    pen.fillStyle = colours.quiet;
    pen.textAlign = "right";
    for (const v of [low, high]) {
      line([[62, y(v)], [width - 8, y(v)]], "rule", 1);
      const small = v !== 0 && Math.abs(v) < 1e-3;
      pen.fillText(small ? v.toExponential(1) : String(Number(v.toPrecision(3))), 56, y(v) + 4);
    }
    if (curve.bound !== null) {
      pen.setLineDash([5, 4]);
      line([[62, y(curve.bound)], [width - 8, y(curve.bound)]], "quiet", 1);
      pen.setLineDash([]);
    }
    line(points.map(([t, v]) => [x(t), y(v)]), "body", 1.2);
    line([[x(data.t[now]), 18], [x(data.t[now]), height - 4]], "blade", 1.5);
  };

  const canvases = data.curves.map((curve) => {
    const canvas = document.createElement("canvas");
    canvas.className = "curve";
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", curve.name + " over time");
    get("curves").append(canvas);
    return canvas;
  });

  const draw = () => {
    place.value = now;
    place.setAttribute("aria-valuetext", data.clock[now]);
    clock.textContent = data.clock[now];
    drawFilm();
    canvases.forEach((canvas, k) => drawCurve(canvas, data.curves[k]));
  };
  const show = (frame) => {
    now = Math.max(0, Math.min(last, frame));
    draw();
  };

  const pause = () => {
    began = null;
    play.textContent = "Play";
  };
  const step = (time) => {
    if (began === null) return;
    const passed = from + Math.floor((time - began) * data.fps / 1000);
    if (passed > last && calm.matches) {
      show(last);
      pause();
      return;
    }
    const frame = Math.max(0, passed) % (last + 1);
    if (frame !== now) show(frame);
    requestAnimationFrame(step);
  };
  const toggle = () => {
    if (began !== null) return pause();
    from = now === last ? 0 : now;
    began = performance.now();
    play.textContent = "Pause";
    requestAnimationFrame(step);
  };
  const go = (frame) => {
    pause();
    show(frame);
  };

  for (const [role, text] of data.key) {
    const item = document.createElement("li"), sample = document.createElement("i");
    sample.style.background = "var(--" + data.roles[role] + ")";
    item.append(sample, text);
    get("key").append(item);
  }
  if (data.squares) {
    const item = document.createElement("li");
    item.textContent = data.squares;
    get("key").append(item);
  }

  film.style.aspectRatio = data.size.join(" / ");
  place.max = last;
  document.querySelector(".controls").hidden = last === 0;
  play.addEventListener("click", toggle);
  place.addEventListener("input", () => go(Number(place.value)));
  const keys = {
    ArrowLeft: () => go(now - 1), ArrowRight: () => go(now + 1),
    Home: () => go(0), End: () => go(last), " ": toggle,
  };
  document.addEventListener("keydown", (event) => {
    const own = event.target === play && event.key === " ";  // a button that is pressed
    if (own || event.ctrlKey || event.altKey || event.metaKey || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
  addEventListener("resize", draw);
  const recolour = () => {
    readColours();
    draw();
  };
  dark.addEventListener("change", recolour);
  if (frameElement) {
    const changes = new MutationObserver(recolour);
    changes.observe(parent.document.documentElement, {attributes: true});
  }

  readColours();
  draw();
  // By itself it moves on a page of its own only, and where that is not unwelcome.
  if (last > 0 && self === top && !calm.matches) toggle();
})();
