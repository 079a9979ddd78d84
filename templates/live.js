"use strict";
// The live figure: one run, or a grid of runs with a slider a key. It reads the element "numbers" and draws on the canvases of live.html.
(() => {
  const byId = (id) => document.getElementById(id);
  const NOTHING = -32768;
  const dark = matchMedia("(prefers-color-scheme: dark)"), calm = matchMedia("(prefers-reduced-motion: reduce)");
  const live = JSON.parse(byId("numbers").textContent);
  const { axes, lists, runs } = live;

  // --- numbers

  const prefixes = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"], [1e-15, "f"]];
  const minus = (text) => String(text).replace("-", "−");
  const inUnits = (x, unit) => {
    const size = Math.abs(x);
    if (size === 0 || !unit) return minus(`${+x.toPrecision(3)}${unit ? ` ${unit}` : ""}`);
    const [power, prefix] = prefixes.find(([least]) => size >= least * 0.9999) || prefixes[prefixes.length - 1];
    return minus(`${+(x / power).toPrecision(3)} ${prefix}${unit}`);
  };
  const nice = (low, high, about) => {
    const raw = (high - low) / Math.max(1, about) || 1, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw * 0.999);
    const ticks = [];
    for (let x = Math.ceil(low / step - 1e-9) * step; x <= high + 1e-9 * step; x += step) ticks.push(Math.abs(x) < 1e-9 * step ? 0 : x);
    return ticks;
  };
  const median = (values) => {
    const sorted = values.filter((x) => x > 0).sort((a, b) => a - b);
    return sorted.length ? sorted[sorted.length >> 1] : 0;
  };
  const unpacked = async () => {
    const packed = Uint8Array.from(atob(live.data), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), half = bytes.length / 2;
    const changes = new Int16Array(half);
    for (let i = 0; i < half; i++) changes[i] = bytes[i] | (bytes[half + i] << 8);
    return changes;
  };
  // an array of T rows was kept as changes from row to row
  const array = (changes, place, rows, columns) => {
    if (!place) return null;
    const [start, unit] = place, values = new Float64Array(rows * columns), sum = new Int16Array(columns);
    for (let i = 0; i < rows * columns; i++) {
      sum[i % columns] += changes[start + i];
      values[i] = sum[i % columns] === NOTHING ? NaN : sum[i % columns] * unit;
    }
    return values;
  };
  const largest = (values) => (values ? values.reduce((most, x) => Math.max(most, Math.abs(x) || 0), 0) : 0);

  let changes = null, run = null, row = 0, column = 0, playing = 0, started = false;
  const opened = (record) => {
    const times = lists[record.time], grains = lists[record.grains], T = times.length, G = grains.length;
    const map = (place) => array(changes, place, T, G), series = (place) => array(changes, place, T, 1);
    const next = { ...record, times, grains, T, G, velocity: map(record.velocity), displacement: map(record.displacement), linear: map(record.linear) };
    Object.assign(next, { kinetic: series(record.kinetic), total: series(record.total), rest: array(changes, record.rest, 1, G - 1) });
    Object.assign(next, { front: array(changes, record.front, 1, G), law: array(changes, record.law, 1, G), most: largest(next.velocity) || 1 });
    // of each contact between grains that are shown, its largest change: beads move and are coloured in units of the median
    const squeezes = [], moves = [];
    for (let g = 0; g < G; g++) {
      let squeeze = 0, move = 0;
      for (let t = 0; t < T; t++) {
        move = Math.max(move, Math.abs(next.displacement[t * G + g]));
        if (g < G - 1) squeeze = Math.max(squeeze, Math.abs(next.displacement[t * G + g] - next.displacement[t * G + g + 1]));
      }
      squeezes.push(squeeze); moves.push(move);
    }
    next.squeeze = median(squeezes) || 1;
    next.exaggeration = Math.min(0.35 / next.squeeze, 3 / (median(moves) || 1));
    return next;
  };
  const at = (t, g) => run.velocity[t * run.G + g];
  const overlap = (t, g) => run.rest[g] + run.displacement[t * run.G + g] - run.displacement[t * run.G + g + 1];

  // --- drawing

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const isDark = () => colour("--dark") === "1";
  const shade = (part) => {
    const x = Math.max(-1, Math.min(1, part)), far = Math.abs(x) ** 0.8, night = isDark();
    const middle = night ? [27, 33, 41] : [247, 247, 247];
    const end = x > 0 ? (night ? [255, 120, 100] : [178, 24, 43]) : (night ? [90, 170, 255] : [33, 102, 172]);
    return middle.map((low, i) => Math.round(low + (end[i] - low) * far));
  };
  const shades = () => Array.from({ length: 201 }, (_, i) => shade((i - 100) / 100));
  const picture = document.createElement("canvas");
  const paint = () => {
    const { T, G } = run, table = shades();
    picture.width = T; picture.height = G;
    const pen = picture.getContext("2d"), image = pen.createImageData(T, G);
    for (let g = 0; g < G; g++) for (let t = 0; t < T; t++) {
      const part = Math.max(-1, Math.min(1, at(t, g) / run.limit));
      image.data.set([...table[Math.round(100 * part) + 100], 255], 4 * (g * T + t));
    }
    pen.putImageData(image, 0, 0);
  };
  const sized = (canvas) => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = colour("--dim"); pen.strokeStyle = colour("--line");
    return { pen, width, height };
  };
  const frame = (canvas, x, y, xlabel, ylabel, xtext, ytext, right = 26) => {
    const { pen, width, height } = sized(canvas);
    const box = { x: 66, y: 18, w: width - 66 - right, h: height - 18 - 34 };
    const place = (a, b) => [box.x + (a - x[0]) / (x[1] - x[0] || 1) * box.w, box.y + (b - y[0]) / (y[1] - y[0] || 1) * box.h];
    pen.textAlign = "center"; pen.textBaseline = "top";
    for (const tick of nice(x[0], x[1], box.w / 80)) pen.fillText(xtext(tick), place(tick, 0)[0], box.y + box.h + 4);
    pen.fillText(xlabel, box.x + box.w / 2, height - 14);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const tick of nice(Math.min(...y), Math.max(...y), box.h / 30)) {
      // A label at the lower end stands above those of the horizontal axis.
      pen.fillText(ytext(tick), box.x - 5, Math.min(place(0, tick)[1], box.y + box.h - 5));
    }
    pen.textAlign = "left"; pen.fillText(ylabel, 4, 8);
    pen.strokeRect(box.x, box.y, box.w, box.h);
    pen.save(); pen.beginPath(); pen.rect(box.x, box.y, box.w, box.h); pen.clip();
    return { pen, box, place };
  };
  const line = (pen, points, style, width, dashes) => {
    pen.save(); pen.strokeStyle = style; pen.lineWidth = width; pen.setLineDash(dashes || []); pen.beginPath();
    let drawn = false;
    for (const [a, b] of points) {
      if (Number.isNaN(a + b)) { drawn = false; continue; }
      if (drawn) pen.lineTo(a, b); else pen.moveTo(a, b);
      drawn = true;
    }
    pen.stroke(); pen.restore();
  };
  const seconds = (x) => inUnits(x, "s"), speed = (x) => inUnits(x, "m/s"), whole = (x) => (Number.isInteger(x) ? String(x) : "");
  let area = null, shownBeads = [0, 0, 1];

  const drawMap = () => {
    const { times, grains, T, G } = run, ends = [times[0], times[T - 1]], depth = [grains[0] - 0.5, grains[G - 1] + 0.5];
    const ink = colour("--ink"), mark = colour("--mark");
    const { pen, box, place } = frame(byId("map"), ends, depth, "time", "grain, from the top; colour: velocity", seconds, whole, 88);
    area = box;
    pen.imageSmoothingEnabled = false; pen.drawImage(picture, box.x, box.y, box.w, box.h);
    if (run.law) line(pen, grains.map((n, g) => place(run.law[g], n)), ink, 1, [5, 4]);
    if (run.front) line(pen, grains.map((n, g) => place(run.front[g], n)), ink, 1.5, [1.5, 2.5]);
    line(pen, [place(times[row], depth[0]), place(times[row], depth[1])], ink, 1.2);
    line(pen, [place(ends[0], grains[column]), place(ends[1], grains[column])], mark, 1.5);
    pen.restore();
    // the scale of colours, downward above
    const x = box.x + box.w + 8, table = shades();
    for (let i = 0; i <= 200; i++) { pen.fillStyle = `rgb(${table[200 - i]})`; pen.fillRect(x, box.y + i / 201 * box.h, 12, box.h / 201 + 1); }
    pen.strokeRect(x, box.y, 12, box.h);
    pen.fillStyle = colour("--dim"); pen.textAlign = "left"; pen.textBaseline = "middle";
    for (const part of [1, 0.5, 0, -0.5, -1]) pen.fillText(speed(part * run.limit), x + 15, box.y + (1 - part) / 2 * box.h);
  };
  const drawBeads = () => {
    const { grains, G } = run, { pen, width, height } = sized(byId("beads"));
    const count = Math.min(G, Math.max(8, Math.floor(width / 14)));
    const first = Math.max(0, Math.min(G - count, column - (count >> 1)));
    const spacing = Math.min(width / (count + 1), height - 34), radius = spacing / 2, left = (width - count * spacing) / 2, middle = 18 + (height - 34) / 2;
    shownBeads = [first, left, spacing];
    const moved = (g) => left + (g - first + 0.5 + run.exaggeration * run.displacement[row * G + g]) * spacing;
    const squeezed = (g) => (g < 0 || g > G - 2 ? 0 : (overlap(row, g) - run.rest[g]) / run.squeeze);
    for (let g = first; g < first + count; g++) {
      const [above, below] = [squeezed(g - 1), squeezed(g)], end = g === 0 || g === G - 1;
      pen.beginPath(); pen.arc(moved(g), middle, radius, 0, 2 * Math.PI);
      pen.fillStyle = `rgb(${shade((above + below) / (end ? 1 : 2))})`; pen.fill();
      pen.lineWidth = g === column ? 3 : 1; pen.strokeStyle = colour(g === column ? "--mark" : "--dim"); pen.stroke();
    }
    // where a contact is open; grains that only touch at rest are not, nor are those between which others are left out
    let gaps = 0;
    for (let g = first; g < Math.min(first + count, G - 1); g++) if (overlap(row, g) < -0.002 * run.squeeze && grains[g + 1] === grains[g] + 1) {
      gaps++;
      const x = (moved(g) + moved(g + 1)) / 2;
      line(pen, [[x, middle - radius - 5], [x, middle + radius + 5]], colour("--open"), 2);
    }
    pen.fillStyle = colour("--dim"); pen.textBaseline = "top"; pen.textAlign = "left";
    pen.fillText(`grains ${grains[first]} to ${grains[first + count - 1]}; red: squeezed, blue: released`, 4, 2);
    pen.textAlign = "right";
    if (gaps) { pen.fillStyle = colour("--open"); pen.fillText(`${gaps} open`, width - 4, 2); }
  };
  const drawLines = () => {
    const { times, grains, T, G } = run, ends = [times[0], times[T - 1]], depth = [grains[0] - 0.5, grains[G - 1] + 0.5];
    const ink = colour("--ink"), mark = colour("--mark"), other = colour("--other"), plain = (x) => String(+x.toFixed(1));
    const all = [run.most * 1.05, -run.most * 1.05];
    let { pen, place } = frame(byId("profile"), depth, all, `grain, from the top`, `velocity downward at ${seconds(times[row])}`, plain, speed);
    if (run.linear) line(pen, grains.map((n, g) => place(n, run.linear[row * G + g])), other, 1.5, [4, 3]);
    line(pen, grains.map((n, g) => place(n, at(row, g))), ink, 1.5);
    line(pen, [place(grains[column], all[0]), place(grains[column], all[1])], mark, 1);
    const motion = times.map((_, t) => at(t, column)), most = largest(motion) || run.most, own = [1.05 * most, -1.05 * most];
    ({ pen, place } = frame(byId("trace"), ends, own, "time", `velocity of grain ${grains[column]}`, seconds, speed));
    if (run.linear) line(pen, times.map((t, i) => place(t, run.linear[i * G + column])), other, 1.5, [4, 3]);
    line(pen, times.map((t, i) => place(t, motion[i])), mark, 1.5);
    line(pen, [place(times[row], own[0]), place(times[row], own[1])], ink, 1);
    byId("energy").hidden = !run.total;
    if (!run.total) return;
    const high = 1.08 * Math.max(...run.total, ...run.kinetic) || 1, joule = (x) => inUnits(x, "J");
    ({ pen, place } = frame(byId("energy"), ends, [high, Math.min(0, ...run.total)], "time", "", seconds, joule));
    line(pen, times.map((t, i) => place(t, run.total[i])), ink, 1.5);
    line(pen, times.map((t, i) => place(t, run.kinetic[i])), mark, 1.5);
    line(pen, times.map((t, i) => place(t, run.total[i] - run.kinetic[i])), colour("--open"), 1.5);
    line(pen, [place(times[row], high), place(times[row], -high)], ink, 1);
    pen.restore();
    let x = 4;
    for (const [word, style] of [["energy:", "--dim"], ["total", "--ink"], ["kinetic", "--mark"], ["potential", "--open"]]) {
      pen.fillStyle = colour(style); pen.textAlign = "left"; pen.textBaseline = "middle"; pen.fillText(word, x, 8);
      x += pen.measureText(`${word} `).width + 3;
    }
  };
  const slider = byId("time"), play = byId("play"), said = byId("said");
  const draw = () => {
    // a figure in a folded part of a page has no size until it is unfolded
    if (!run || !byId("map").clientWidth || !byId("map").clientHeight) return;
    drawMap(); drawBeads(); drawLines();
    slider.value = row;
    slider.setAttribute("aria-valuetext", seconds(run.times[row]));
    const linear = run.linear ? `, linear theory ${speed(run.linear[row * run.G + column])}` : "";
    const moved = inUnits(run.displacement[row * run.G + column], "m");
    said.textContent = `Grain ${run.grains[column]} at ${seconds(run.times[row])}: ${speed(at(row, column))}${linear}, displaced by ${moved}`;
  };

  // --- steering

  const go = (t, g) => { row = Math.max(0, Math.min(run.T - 1, t)); column = Math.max(0, Math.min(run.G - 1, g)); draw(); };
  const stop = () => {
    clearInterval(playing); playing = 0;
    play.textContent = "Play"; play.setAttribute("aria-pressed", "false"); said.setAttribute("aria-live", "polite");
    draw();
  };
  const start = () => {
    if (row === run.T - 1) row = 0;
    play.textContent = "Pause"; play.setAttribute("aria-pressed", "true");
    // a reader of the screen would read every time that goes by
    said.setAttribute("aria-live", "off");
    // who asks for less motion sees twelve still pictures
    const jump = calm.matches ? Math.max(1, Math.round(run.T / 12)) : 1;
    playing = setInterval(() => (row === run.T - 1 ? stop() : go(row + jump, column)), calm.matches ? 700 : Math.max(16, 8000 / run.T));
  };
  const toggle = () => (playing ? stop() : start());
  const point = (event, withTime) => {
    const place = byId("map").getBoundingClientRect();
    const t = Math.round((event.clientX - place.left - area.x) / area.w * (run.T - 1));
    const g = Math.floor((event.clientY - place.top - area.y) / area.h * run.G);
    if (g >= 0 && g < run.G) go(withTime ? t : row, g);
  };
  const onKey = (event) => {
    const far = event.shiftKey ? 10 : 1;
    const moves = { ArrowUp: [0, -far], ArrowDown: [0, far], ArrowLeft: [-far, 0], ArrowRight: [far, 0], Home: [-run.T, 0], End: [run.T, 0] };
    if (event.key === " ") toggle(); else if (moves[event.key]) go(row + moves[event.key][0], column + moves[event.key][1]); else return;
    event.preventDefault();
  };
  const onBead = (event) => {
    const [first, left, spacing] = shownBeads, x = event.clientX - byId("beads").getBoundingClientRect().left;
    go(row, first + Math.floor((x - left) / spacing));
  };
  byId("map").addEventListener("pointermove", (event) => point(event, event.buttons === 1));
  byId("map").addEventListener("pointerdown", (event) => point(event, true));
  byId("map").addEventListener("keydown", onKey);
  byId("beads").addEventListener("pointermove", onBead);
  byId("beads").addEventListener("pointerdown", onBead);
  slider.addEventListener("input", () => go(Number(slider.value), column));
  play.addEventListener("click", toggle);
  byId("back").addEventListener("click", () => go(row - 1, column));
  byId("forward").addEventListener("click", () => go(row + 1, column));

  // --- which run is shown

  const places = axes.map((axis) => axis.start);
  const shown = () => runs[places.reduce((number, place, k) => number * axes[k].values.length + place, 0)];
  const change = () => {
    const record = shown();
    axes.forEach((axis, k) => {
      const text = inUnits(axis.values[places[k]], axis.unit);
      byId(`axis-${k}`).value = places[k];
      byId(`axis-${k}`).setAttribute("aria-valuetext", text);
      byId(`value-${k}`).textContent = `${text} (run ${places[k] + 1} of ${axis.values.length})`;
    });
    byId("live").hidden = Boolean(record.reason);
    if (byId("reason")) byId("reason").textContent = record.reason ? `This run failed: ${record.reason}` : "";
    if (byId("facts")) byId("facts").replaceChildren(...(record.facts || []).map(([name, text]) => {
      const card = document.createElement("div"), term = document.createElement("dt"), value = document.createElement("dd");
      card.className = "card"; term.textContent = name; value.textContent = text;
      card.append(term, value);
      return card;
    }));
    if (record.reason) return;
    const before = run;
    run = opened(record);
    if (before) { row = Math.round(row / (before.T - 1) * (run.T - 1)); column = Math.round(column / Math.max(1, before.G - 1) * (run.G - 1)); }
    if (!started) {
      // the grain below the first quarter that moves most, in the middle of the run
      for (let g = run.G >> 2, most = 0; g < run.G; g++) for (let t = 0; t < run.T; t++) if (Math.abs(at(t, g)) > most) { most = Math.abs(at(t, g)); column = g; }
      row = run.T >> 1; started = true;
    }
    slider.max = run.T - 1;
    paint(); draw();
  };
  // A typed number selects the nearest run, by ratio on a logarithmic axis; the box then shows the value of that run.
  const nearest = (axis, value) => {
    const size = axis.log ? Math.log : (x) => x, far = axis.values.map((x) => Math.abs(size(x) - size(value)));
    return far.indexOf(Math.min(...far));
  };
  axes.forEach((axis, k) => {
    byId(`axis-${k}`).addEventListener("input", (event) => { places[k] = Number(event.target.value); byId(`typed-${k}`).value = ""; change(); });
    byId(`typed-${k}`).addEventListener("change", (event) => {
      const box = event.target, value = Number(box.value.replace(",", "."));
      const valid = Boolean(box.value.trim()) && Number.isFinite(value) && !(axis.log && value <= 0);
      box.setCustomValidity(valid ? "" : axis.log ? "Type a positive number." : "Type a number.");
      if (!box.reportValidity()) return;
      places[k] = nearest(axis, value);
      change();
      box.value = axis.values[places[k]];
    });
  });

  // --- a page within another: it takes its colours, and tells its height
  const restyle = () => { if (run) { paint(); draw(); } };
  dark.addEventListener("change", restyle);
  addEventListener("beforeprint", () => { document.documentElement.dataset.printing = ""; restyle(); });
  addEventListener("afterprint", () => { delete document.documentElement.dataset.printing; restyle(); });
  addEventListener("message", (event) => {
    if (!event.data || !("lmpchainTheme" in event.data)) return;
    const theme = event.data.lmpchainTheme;
    if (theme === "dark" || theme === "light") document.documentElement.dataset.theme = theme; else delete document.documentElement.dataset.theme;
    restyle();
  });
  if (window.parent !== window) {
    document.documentElement.classList.add("within");
    new ResizeObserver(() => window.parent.postMessage({ lmpchainHeight: document.documentElement.offsetHeight }, "*")).observe(document.body);
  }
  unpacked().then((values) => {
    changes = values;
    change();
    new ResizeObserver(draw).observe(byId("map"));
    document.documentElement.dataset.ready = "1";
  });
})();
