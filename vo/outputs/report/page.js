// The 3D view of paths, and values under the pointer in figures. Loads nothing.
"use strict";
(() => {
  const css = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const show = value => value == null || Number.isNaN(value) ? "–"
    : String(+value.toPrecision(4)).replace("-", "−");
  const units = (top, unit) => {  // factor and name of the unit that fits
    if (!/^m(\/s)?$/.test(unit) || top >= 0.5) return [1, unit];
    return top < 0.03 ? [1000, "m" + unit] : [100, "c" + unit];
  };
  const quantity = (value, unit) => {
    const [factor, name] = units(Math.abs(value), unit);
    return `${show(factor * value)} ${name}`;
  };
  const isDark = matchMedia("screen and (prefers-color-scheme: dark)");
  // Viridis without its end that the background would hide.
  const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const ramp = part => {
    const at = (isDark.matches ? 0.22 + 0.78 * part : 0.85 * part) * (RAMP.length - 1);
    const low = Math.min(Math.floor(at), RAMP.length - 2), rest = at - low;
    return `rgb(${RAMP[low].map((c, i) => Math.round(c + rest * (RAMP[low + 1][i] - c)))})`;
  };
  const nice = length => {
    const power = 10 ** Math.floor(Math.log10(length));
    return power * [5, 2, 1].find(step => step * power <= length);
  };
  const marks = [];  // functions that mark a time, of every figure
  const markAll = seconds => marks.forEach(mark => mark(seconds));
  const place = (tip, box, x, y) => {
    tip.style.left = `${Math.max(0, Math.min(x + 14, box.width - tip.offsetWidth))}px`;
    tip.style.top = `${Math.max(0, y - tip.offsetHeight - 10)}px`;
  };

  function view(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const canvas = figure.querySelector("canvas"), pen = canvas.getContext("2d");
    const select = figure.querySelector("select"), key = figure.querySelector(".key");
    const tip = figure.querySelector(".tip"), fingers = new Map();
    const UNITS = {error: "m", speed: `${data.unit}/s`, sigma: data.unit};
    const low = [0, 1, 2].map(() => Infinity), high = low.map(() => -Infinity);
    data.runs.forEach(run => run.points.forEach((value, i) => {
      low[i % 3] = Math.min(low[i % 3], value); high[i % 3] = Math.max(high[i % 3], value);
    }));
    const middle = low.map((value, i) => (value + high[i]) / 2);
    const size = Math.max(1e-6, Math.hypot(...low.map((value, i) => high[i] - value)));
    // Direction of the largest horizontal extent.
    const moments = [0, 0, 0];
    data.runs.forEach(run => run.time.forEach((_, row) => {
      const [x, y] = [0, 1].map(i => run.points[3 * row + i] - middle[i]);
      moments[0] += x * x; moments[1] += x * y; moments[2] += y * y;
    }));
    let along = Math.atan2(2 * moments[1], moments[0] - moments[2]) / 2;
    const ends = data.runs[0].points.slice(-3).map((value, i) => value - data.runs[0].points[i]);
    if (ends[0] * Math.cos(along) + ends[1] * Math.sin(along) < 0) along += Math.PI;
    let yaw, pitch, zoom, shift, width, height, scale, range, picked = null;

    const turn = name => {
      [yaw, pitch] = {above: [0, Math.PI / 2], side: [along, 0]}[name] || [along - 0.4, 0.6];
      zoom = 1; shift = [0, 0];
      scale = 1;
      const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(
        n => project(low.map((value, i) => (n >> i) & 1 ? high[i] : value)));
      const spread = k => Math.max(size / 20, ...corners.map(c => 2 * Math.abs(c[k] - [width, height][k] / 2)));
      scale = Math.min((width - 70) / spread(0), (height - 90) / spread(1));
    };
    function project(p) {
      const [x, y, z] = p.map((value, i) => value - middle[i]);
      const c = Math.cos(yaw), s = Math.sin(yaw);
      const up = (y * c - x * s) * Math.sin(pitch) + z * Math.cos(pitch);
      const k = scale * zoom;
      return [width / 2 + shift[0] + k * (x * c + y * s), height / 2 + shift[1] - k * up];
    }
    const point = (list, row) => project(list.slice(3 * row, 3 * row + 3));
    const line = (points, style, thick, dash = []) => {
      pen.beginPath(); pen.strokeStyle = style; pen.lineWidth = thick; pen.setLineDash(dash);
      let pending = true;
      for (let row = 0; row < points.length / 3; row++) {
        if (points[3 * row] == null) { pending = true; continue; }
        pen[pending ? "moveTo" : "lineTo"](...point(points, row)); pending = false;
      }
      pen.stroke(); pen.setLineDash([]);
    };
    const label = (text, x, y, style = css("ink")) => {
      pen.lineWidth = 3; pen.strokeStyle = css("paper"); pen.strokeText(text, x, y);
      pen.fillStyle = style; pen.fillText(text, x, y);
    };

    function grid() {
      const step = nice(size / 6), floor = low[2];
      const [first, last] = [0, 1].map(k => [low, high].map(
        (edge, end) => Math.round(edge[k] / step + (end ? 0.49 : -0.49)) * step)).reduce(
        (a, b) => [[a[0], b[0]], [a[1], b[1]]]);
      for (let k = 0; k < 2; k++)
        for (let at = first[k]; at <= last[k] + step / 2; at += step) {
          const ends = [first, last].flatMap(edge => [k ? edge[0] : at, k ? at : edge[1], floor]);
          line(ends, css("grid"), 1);
        }
    }
    function path(run) {
      const by = select.value, values = run[by], count = run.time.length;
      const cuts = new Set(run.cuts), dash = data.runs.length > 1 && by != "run" && run.colour % 2;
      const groups = new Map();
      for (let row = 1; row < count; row++) {
        if (cuts.has(row)) continue;
        const style = by == "run" ? css(`series-${run.colour}`) : values[row] == null ? css("muted")
          : ramp(Math.round(24 * Math.min(1, Math.max(0, (values[row] - range[0]) / (range[1] - range[0])))) / 24);
        groups.set(style, [...(groups.get(style) || []), row]);
      }
      pen.lineCap = "round"; pen.setLineDash(dash ? [7, 5] : []);
      for (const [style, rows] of groups) {
        pen.beginPath(); pen.strokeStyle = style; pen.lineWidth = 2.6;
        let before = -1;
        for (const row of rows) {
          if (row != before + 1) pen.moveTo(...point(run.points, row - 1));
          pen.lineTo(...point(run.points, row)); before = row;
        }
        pen.stroke();
      }
      pen.setLineDash([]);
    }
    function signs(run) {
      const dots = (points, style, radius) => {
        for (let row = 0; row < points.length / 3; row++) {
          pen.beginPath(); pen.arc(...point(points, row), radius, 0, 7);
          pen.fillStyle = style; pen.fill();
        }
      };
      for (let row = 0; row < run.loops.length / 6; row++)
        line(run.loops.slice(6 * row, 6 * row + 6), css("series-1"), 1.2);
      dots(run.loops, css("series-1"), 2.5);
      dots(run.found, css("ink"), 4);
      run.markers.forEach(([name, ...at]) => {
        dots(at, css("series-3"), 4);
        const [x, y] = project(at); label(name, x + 6, y - 5);
      });
      const last = run.time.length - 1, [sx, sy] = point(run.points, 0), [ex, ey] = point(run.points, last);
      dots(run.points.slice(0, 3), css("ink"), 5);
      pen.fillStyle = css("paper"); pen.strokeStyle = css("ink"); pen.lineWidth = 2;
      pen.fillRect(ex - 5, ey - 5, 10, 10); pen.strokeRect(ex - 5, ey - 5, 10, 10);
      if (data.runs.length > 1) return;
      const near = Math.hypot(sx - ex, sy - ey) < 30;
      pen.textAlign = "center";
      label(near ? "start, end" : "start", Math.max(sx, 20), sy - 11);
      if (!near) label("end", Math.min(ex, width - 16), ey - 11);
      pen.textAlign = "left";
    }
    function frame() {
      // The scale is the same in the whole picture: there is no perspective.
      const bar = nice(width / 4 / (scale * zoom)), long = bar * scale * zoom;
      pen.strokeStyle = css("ink"); pen.lineWidth = 2; pen.beginPath();
      pen.moveTo(width - 14 - long, height - 19); pen.lineTo(width - 14 - long, height - 14);
      pen.lineTo(width - 14, height - 14); pen.lineTo(width - 14, height - 19); pen.stroke();
      pen.textAlign = "right"; label(`${show(bar)} ${data.unit}`, width - 14, height - 24);
      pen.textAlign = "center";
      const origin = [46, height - 46], zero = project(middle);
      data.names.forEach((name, i) => {
        const to = project(middle.map((value, j) => value + (i == j ? 1 / scale / zoom : 0)));
        const [x, y] = [to[0] - zero[0], to[1] - zero[1]], long = Math.hypot(x, y);
        if (long < 0.15) return;
        const isNorth = data.isMap && i == 1;
        pen.strokeStyle = css(isNorth ? "series-1" : "muted"); pen.lineWidth = isNorth ? 2.5 : 1.5;
        pen.beginPath(); pen.moveTo(...origin);
        const [tx, ty] = [origin[0] + 26 * x, origin[1] + 26 * y];
        pen.lineTo(tx, ty); pen.stroke();
        const angle = Math.atan2(y, x);
        pen.beginPath(); pen.fillStyle = pen.strokeStyle;
        [0, 2.6, -2.6].forEach(turned => pen.lineTo(tx + 6 * Math.cos(angle + turned), ty + 6 * Math.sin(angle + turned)));
        pen.fill();
        label(data.isMap ? {east: "E", north: "N", up: "up"}[name] : name, tx + 11 * x / long, ty + 11 * y / long + 4);
      });
      pen.textAlign = "left";
    }
    function draw() {
      if (!width) return;
      pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
      pen.clearRect(0, 0, width, height); pen.font = "13px system-ui, sans-serif";
      grid();
      if (pitch < 1.5) data.runs.forEach(run => {  // its shadow on the ground
        const ground = run.points.map((value, i) => i % 3 == 2 ? low[2] : value);
        run.cuts.forEach(row => { ground[3 * row] = null; });
        line(ground, css("line"), 1.5);
      });
      // Where the other sensor was, as a road: the background of the map.
      pen.lineJoin = "round"; line(data.given, css("raised"), 26); line(data.given, css("line"), 1);
      pen.globalAlpha = 0.45; line(data.truth, css("muted"), 6); pen.globalAlpha = 1;
      for (let row = 0; row < data.given.length / 3; row++) {
        pen.beginPath(); pen.arc(...point(data.given, row), 2.2, 0, 7);
        pen.fillStyle = css("series-4"); pen.fill();
      }
      data.runs.forEach(run => line(run.before, css("muted"), 1.2, [5, 4]));
      data.runs.forEach(path); data.runs.forEach(signs);
      frame();
      if (picked) picked.forEach(([run, row]) => {
        pen.beginPath(); pen.arc(...point(data.runs[run].points, row), 6, 0, 7);
        pen.strokeStyle = css("ink"); pen.lineWidth = 2.5; pen.stroke();
      });
    }
    function legend() {
      const by = select.value;
      const values = by == "run" ? [] : data.runs.flatMap(run => run[by].filter(v => v != null)).sort((a, b) => a - b);
      const top = values[Math.floor(0.99 * (values.length - 1))];
      range = [values[0], Math.max(top, values[0] + 1e-9)];
      const item = (sign, text) => {
        const span = document.createElement("span"), mark = document.createElement("i");
        span.append(mark, text); Object.assign(mark.style, sign); key.append(span);
      };
      key.textContent = "";
      if (values.length) {
        const stops = [0, 0.25, 0.5, 0.75, 1].map(ramp).join();
        const [factor, unit] = units(range[1], UNITS[by]);
        const more = values[values.length - 1] > range[1] ? " or more" : "";
        item({width: "120px", background: `linear-gradient(90deg,${stops})`},
          `${show(factor * range[0])} to ${show(factor * range[1])} ${unit}${more}`);
        if (data.runs.length > 1) data.runs.forEach(run => item(
          {borderTop: `3px ${run.colour % 2 ? "dashed" : "solid"} var(--muted)`, height: "0"}, run.name));
      } else data.runs.forEach(run => item({background: `var(--series-${run.colour})`}, data.runs.length > 1 ? run.name : "estimate"));
      if (data.given.length) item({background: "var(--series-4)", width: "6px", height: "6px", borderRadius: "9px"}, data.givenName);
      if (data.truth.length) item({background: "var(--muted)", opacity: 0.5}, "ground truth");
      item({background: "var(--ink)", width: "10px", height: "10px", borderRadius: "9px"}, "start");
      item({border: "2px solid var(--ink)", width: "10px", height: "10px"}, "end");
      if (data.runs.some(run => run.loops.length)) {
        item({background: "var(--series-1)", height: "2px"}, "loop");
        item({borderTop: "2px dashed var(--muted)", height: "0"}, "before loops");
      }
      if (data.runs.some(run => run.found.length)) item({background: "var(--ink)", width: "8px", height: "8px", borderRadius: "9px"}, "relocalised");
      if (data.runs.some(run => run.markers.length)) item({background: "var(--series-3)", width: "8px", height: "8px", borderRadius: "9px"}, "marker");
    }
    function hover(x, y) {
      let best = [20 * 20];
      data.runs.forEach((run, number) => run.time.forEach((_, row) => {
        const [px, py] = point(run.points, row), apart = (px - x) ** 2 + (py - y) ** 2;
        if (apart < best[0]) best = [apart, number, row];
      }));
      tip.textContent = "";
      if (best.length < 2) { markAll(null); return; }
      const [, number, row] = best, run = data.runs[number];
      const where = data.names.map((name, i) => `${name} ${show(run.points[3 * row + i])}`).join(", ");
      const lines = [data.runs.length > 1 ? run.name : "", `frame ${run.frame[row] < 0 ? "–" : run.frame[row]}, ${show(run.time[row])} s`,
        `${where} ${data.unit}`, ...[["speed", "speed"], ["error", "error"], ["sigma", "σ"]].filter(([by]) => run[by][row] != null).map(
          ([by, name]) => `${name} ${quantity(run[by][row], UNITS[by])}`)];
      tip.textContent = lines.filter(Boolean).join("\n");
      place(tip, {width}, x, y);
      markAll(run.time[row]);
    }
    marks.push(seconds => {
      picked = seconds == null ? null : data.runs.map((run, number) => {
        let row = run.time.findIndex(time => time >= seconds);
        if (row < 0) row = run.time.length - 1;
        return [number, row];
      });
      draw();
    });
    function resize() {
      const ratio = devicePixelRatio, was = width;
      width = canvas.clientWidth; height = canvas.clientHeight;
      canvas.width = width * ratio; canvas.height = height * ratio;
      if (!was) turn(data.isMap ? "above" : "3d"); else scale *= width / was;
      draw();
    }
    function move(event) {
      const now = [event.offsetX, event.offsetY], before = fingers.get(event.pointerId);
      if (!before) { hover(...now); return; }
      const others = [...fingers].filter(([id]) => id != event.pointerId).map(each => each[1]);
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      if (others.length) {
        const apart = p => Math.hypot(p[0] - others[0][0], p[1] - others[0][1]);
        zoom *= apart(now) / Math.max(1, apart(before)); shift[0] += dx / 2; shift[1] += dy / 2;
      } else if (event.shiftKey || event.buttons > 1) { shift[0] += dx; shift[1] += dy; }
      else { yaw -= dx / 150; pitch = Math.min(Math.PI / 2, Math.max(-0.3, pitch + dy / 150)); }
      fingers.set(event.pointerId, now);
      tip.textContent = ""; draw();
    }
    canvas.addEventListener("pointerdown", event => {
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      canvas.setPointerCapture(event.pointerId); canvas.focus({preventScroll: true}); hover(event.offsetX, event.offsetY);
    });
    canvas.addEventListener("pointermove", move);
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, event => fingers.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => { tip.textContent = ""; markAll(null); });
    canvas.addEventListener("contextmenu", event => event.preventDefault());
    canvas.addEventListener("wheel", event => {
      if (document.activeElement != canvas) return;  // the page scrolls until the view was clicked
      event.preventDefault(); zoom *= Math.exp(-event.deltaY / 500); draw();
    }, {passive: false});
    const KEYS = {ArrowLeft: () => yaw += 0.1, ArrowRight: () => yaw -= 0.1,
      ArrowUp: () => pitch = Math.min(Math.PI / 2, pitch + 0.1), ArrowDown: () => pitch = Math.max(-0.3, pitch - 0.1),
      "+": () => zoom *= 1.25, "-": () => zoom /= 1.25};
    canvas.addEventListener("keydown", event => {
      if (!KEYS[event.key]) return;
      event.preventDefault(); KEYS[event.key](); draw();
    });
    figure.querySelectorAll("button").forEach(button => button.addEventListener("click", () => {
      const name = button.dataset.view;
      if (name == "in" || name == "out") KEYS[name == "in" ? "+" : "-"](); else turn(name);
      draw();
    }));
    select.addEventListener("change", () => { legend(); draw(); });
    isDark.addEventListener("change", () => { legend(); draw(); });
    figure.hidden = false; legend();
    new ResizeObserver(resize).observe(canvas);
  }

  function chart(svg) {
    const prefix = svg.dataset.prefix, all = JSON.parse(svg.dataset.curves), figure = svg.parentElement;
    const tip = document.createElement("p"), lines = [];
    tip.className = "tip"; figure.append(tip);
    for (const axes of all) {
      axes.isTime = axes.labels[0] == "time (s)";
      axes.pieces = axes.curves.map(([id]) => {
        const path = svg.querySelector(`[id="${prefix}-${id}"] path`);
        return path ? path.getAttribute("d").split("M").slice(1).map(
          piece => piece.split("L").map(pair => pair.trim().split(/\s+/).map(Number))) : [];
      });
      const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
      line.setAttribute("stroke", "var(--ink)"); line.setAttribute("stroke-width", 0.6);
      line.style.display = "none"; svg.append(line); lines.push(line);
    }
    const toX = (axes, u) => {
      const [a, b] = axes.log ? axes.x.map(Math.log) : axes.x, x = a + (u - axes.box[0]) / axes.box[2] * (b - a);
      return axes.log ? Math.exp(x) : x;
    };
    const toY = (axes, v) => axes.y[1] - (v - axes.box[1]) / axes.box[3] * (axes.y[1] - axes.y[0]);
    const valueAt = (axes, pieces, u) => {
      for (const piece of pieces)
        for (let n = 1; n < piece.length; n++) {
          const [[x0, y0], [x1, y1]] = [piece[n - 1], piece[n]];
          if (x0 <= u && u <= x1) return toY(axes, x1 > x0 ? y0 + (u - x0) / (x1 - x0) * (y1 - y0) : y1);
        }
    };
    const mark = (number, u) => {
      const [, top, , tall] = all[number].box, line = lines[number];
      line.style.display = u == null ? "none" : "";
      if (u != null) Object.entries({x1: u, x2: u, y1: top, y2: top + tall}).forEach(e => line.setAttribute(...e));
    };
    marks.push(seconds => all.forEach((axes, number) => {
      const u = axes.box[0] + (seconds - axes.x[0]) / (axes.x[1] - axes.x[0]) * axes.box[2];
      const isInside = seconds != null && u >= axes.box[0] && u <= axes.box[0] + axes.box[2];
      if (axes.isTime) mark(number, isInside ? u : null);
    }));
    const leave = () => { tip.textContent = ""; all.forEach((_, number) => mark(number, null)); markAll(null); };
    svg.addEventListener("pointermove", event => {
      const box = svg.getBoundingClientRect(), ratio = svg.viewBox.baseVal.width / box.width;
      const u = (event.clientX - box.left) * ratio, v = (event.clientY - box.top) * ratio;
      const number = all.findIndex(({box: [x, y, w, h]}) => x <= u && u <= x + w && y <= v && v <= y + h);
      if (number < 0) { leave(); return; }
      const axes = all[number], x = toX(axes, u);
      const texts = axes.curves.map(([, name], row) => {
        const value = valueAt(axes, axes.pieces[row], u);
        return value == null ? "" : `${name || axes.labels[1]}: ${show(value)}`;
      });
      tip.textContent = [`${axes.labels[0]}: ${show(x)}`, ...new Set(texts.filter(Boolean))].join("\n");
      place(tip, box, event.clientX - box.left, event.clientY - box.top);
      if (axes.isTime) markAll(x); else mark(number, u);
    });
    svg.addEventListener("pointerleave", leave);
  }

  document.querySelectorAll("figure.view").forEach(view);
  document.querySelectorAll(".flat").forEach(each => { each.hidden = true; });
  document.querySelectorAll("svg[data-curves]").forEach(chart);
})();
