"use strict";
(() => {
  const byId = (id) => document.getElementById(id);
  const live = JSON.parse(byId("numbers").textContent);
  const times = live.time, grains = live.grains, T = times.length, G = grains.length;
  const bytes = Uint8Array.from(atob(live.data), (letter) => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const value = (t, g) => view.getInt16(2 * (t * G + g), true) / 32767 * live.largest;
  const map = byId("map"), profile = byId("profile"), trace = byId("trace");
  const slider = byId("time"), play = byId("play"), said = byId("said");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let row = T - 1, column = 0, playing = 0;
  for (let g = 0, most = 0; g < G; g++) {
    for (let t = 0; t < T; t++) if (g > G / 4 && Math.abs(value(t, g)) > most) { most = Math.abs(value(t, g)); column = g; }
  }
  const prefixes = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];
  const inUnits = (x, unit) => {
    const size = Math.abs(x), found = prefixes.find(([least]) => size >= least * 0.9999) || [1e-12, "p"];
    return size === 0 ? `0 ${unit}` : `${+(x / found[0]).toPrecision(3)} ${found[1]}${unit}`;
  };
  const nice = (low, high, about) => {
    const raw = (high - low) / about || 1, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw * 0.999);
    const ticks = [];
    for (let x = Math.ceil(low / step - 1e-9) * step; x <= high + 1e-9 * step; x += step) ticks.push(Math.abs(x) < 1e-9 * step ? 0 : x);
    return ticks;
  };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const shade = (x) => {
    const part = Math.max(-1, Math.min(1, x / live.limit)), far = Math.abs(part) ** 0.8;
    const middle = dark.matches ? [27, 33, 41] : [247, 247, 247];
    const end = part > 0 ? (dark.matches ? [255, 120, 100] : [178, 24, 43]) : (dark.matches ? [90, 170, 255] : [33, 102, 172]);
    return middle.map((low, i) => Math.round(low + (end[i] - low) * far));
  };
  const picture = document.createElement("canvas");
  const paint = () => {
    picture.width = T; picture.height = G;
    const pen = picture.getContext("2d"), image = pen.createImageData(T, G);
    for (let g = 0; g < G; g++) for (let t = 0; t < T; t++) image.data.set([...shade(value(t, g)), 255], 4 * (g * T + t));
    pen.putImageData(image, 0, 0);
  };
  const margin = { left: 66, right: 26, top: 8, bottom: 34 };
  const frame = (canvas, x, y, xlabel, ylabel, xtext, ytext) => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const box = { x: margin.left, y: margin.top, w: width - margin.left - margin.right, h: height - margin.top - margin.bottom };
    const at = (a, b) => [box.x + (a - x[0]) / (x[1] - x[0] || 1) * box.w, box.y + (b - y[0]) / (y[1] - y[0] || 1) * box.h];
    pen.clearRect(0, 0, width, height);
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = colour("--dim"); pen.strokeStyle = colour("--line");
    pen.textAlign = "center"; pen.textBaseline = "top";
    for (const tick of nice(x[0], x[1], box.w / 80)) pen.fillText(xtext(tick), at(tick, 0)[0], box.y + box.h + 4);
    pen.fillText(xlabel, box.x + box.w / 2, height - 14);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const tick of nice(Math.min(...y), Math.max(...y), box.h / 30)) pen.fillText(ytext(tick), box.x - 5, at(0, tick)[1]);
    if (ylabel) {
      pen.save(); pen.translate(12, box.y + box.h / 2); pen.rotate(-Math.PI / 2); pen.textAlign = "center"; pen.fillText(ylabel, 0, 0); pen.restore();
    }
    pen.strokeRect(box.x, box.y, box.w, box.h);
    return { pen, box, at };
  };
  const line = (pen, points, style, width, dashes) => {
    pen.save(); pen.strokeStyle = style; pen.lineWidth = width; pen.setLineDash(dashes || []); pen.beginPath();
    points.forEach((point, i) => (i ? pen.lineTo(...point) : pen.moveTo(...point)));
    pen.stroke(); pen.restore();
  };
  let area = null;
  const draw = () => {
    const ends = [times[0], times[T - 1]], depth = [grains[0] - 0.5, grains[G - 1] + 0.5], ink = colour("--ink"), mark = colour("--mark");
    const velocity = (x) => inUnits(x, "m/s"), micro = (x) => inUnits(x, "s"), plain = (x) => String(+x.toFixed(1));
    const whole = (x) => (Number.isInteger(x) ? String(x) : "");
    let { pen, box, at } = frame(map, ends, depth, "time", "grain, from the top", micro, whole);
    area = box;
    pen.imageSmoothingEnabled = false; pen.drawImage(picture, box.x, box.y, box.w, box.h);
    if (live.law.length) {
      pen.save(); pen.beginPath(); pen.rect(box.x, box.y, box.w, box.h); pen.clip();
      line(pen, live.law.map((t, g) => at(t, grains[g])), ink, 1, [5, 4]); pen.restore();
    }
    line(pen, [at(times[row], depth[0]), at(times[row], depth[1])], ink, 1.2);
    line(pen, [at(ends[0], grains[column]), at(ends[1], grains[column])], mark, 1.5);
    const all = [live.largest * 1.05, -live.largest * 1.05];
    ({ pen, at } = frame(profile, depth, all, `grain, at ${inUnits(times[row], "s")}`, "", plain, velocity));
    line(pen, grains.map((n, g) => at(n, value(row, g))), ink, 1.5);
    line(pen, [at(grains[column], all[0]), at(grains[column], all[1])], mark, 1);
    let most = 0;
    for (let t = 0; t < T; t++) most = Math.max(most, Math.abs(value(t, column)));
    const own = [1.05 * most || live.largest, -1.05 * most || -live.largest];
    ({ pen, at } = frame(trace, ends, own, `time, grain ${grains[column]}`, "", micro, velocity));
    line(pen, times.map((t, i) => at(t, value(i, column))), mark, 1.5);
    line(pen, [at(times[row], own[0]), at(times[row], own[1])], ink, 1);
    slider.value = row;
    slider.setAttribute("aria-valuetext", inUnits(times[row], "s"));
    if (!playing) said.textContent = `Grain ${grains[column]} at ${inUnits(times[row], "s")}: ${inUnits(value(row, column), "m/s")}`;
  };
  const go = (t, g) => { row = Math.max(0, Math.min(T - 1, t)); column = Math.max(0, Math.min(G - 1, g)); draw(); };
  const stop = () => { clearInterval(playing); playing = 0; play.textContent = "Play"; play.setAttribute("aria-pressed", "false"); draw(); };
  const start = () => {
    if (row === T - 1) row = 0;
    play.textContent = "Pause"; play.setAttribute("aria-pressed", "true");
    playing = setInterval(() => (row === T - 1 ? stop() : go(row + 1, column)), Math.max(16, 6000 / T));
  };
  const toggle = () => (playing ? stop() : start());
  const point = (event, withTime) => {
    const place = map.getBoundingClientRect();
    const t = Math.round((event.clientX - place.left - area.x) / area.w * (T - 1));
    const g = Math.floor((event.clientY - place.top - area.y) / area.h * G);
    if (g >= 0 && g < G) go(withTime ? t : row, g);
  };
  map.addEventListener("pointermove", (event) => point(event, event.buttons === 1));
  map.addEventListener("pointerdown", (event) => point(event, true));
  map.addEventListener("keydown", (event) => {
    const far = event.shiftKey ? 10 : 1;
    const moves = { ArrowUp: [0, -far], ArrowDown: [0, far], ArrowLeft: [-far, 0], ArrowRight: [far, 0], Home: [-T, 0], End: [T, 0] };
    if (event.key === " ") toggle(); else if (moves[event.key]) go(row + moves[event.key][0], column + moves[event.key][1]); else return;
    event.preventDefault();
  });
  slider.max = T - 1;
  slider.addEventListener("input", () => go(Number(slider.value), column));
  play.addEventListener("click", toggle);
  dark.addEventListener("change", () => { paint(); draw(); });
  byId("live").hidden = false;
  paint();
  new ResizeObserver(draw).observe(map);
  draw();
})();
