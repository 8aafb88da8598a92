// Draws the plots of a report when they come into sight, in the colours of the reader's choice, with one time axis.
"use strict";
(async () => {
  const read = (id) => document.getElementById(id).textContent;
  const packed = Uint8Array.from(atob(read("library")), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const library = document.createElement("script");
  library.textContent = await new Response(stream).text();
  document.head.append(library);

  const figures = JSON.parse(read("figures"));
  const plots = [...document.querySelectorAll(".chart")];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  // Okabe and Ito 2008, for all kinds of colour vision; what is too light or too dark for its background is shifted.
  const onLight = ["#0072b2", "#d55e00", "#009e73", "#b8579a", "#b8860b", "#3a9ad9", "#6b4c9a"];
  const onDark = ["#56a8e0", "#f5853f", "#2fc99a", "#e08cc0", "#e6b422", "#8fd0ff", "#b39ae0"];
  const dashes = ["solid", "dash", "dot"];
  let printing = false;
  let range = null; // of the time axes; null: all of it
  const hidden = new Set(); // names that are hidden by a legend

  const colours = () =>
    dark.matches && !printing
      ? { lines: onDark, text: "#e8eaed", truth: "#8a919c", grid: "#363b43", back: "#16181c" }
      : { lines: onLight, text: "#1c1e21", truth: "#8b929d", grid: "#e1e4e8", back: "#ffffff" };
  const shade = (hex, alpha) => `rgba(${[1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)).join(",")},${alpha})`;

  function traces(figure, theme) {
    const found = [];
    for (const { c, band, area, ...trace } of figure.traces) {
      if (hidden.has(trace.legendgroup)) trace.visible = "legendonly";
      const colour = typeof c === "number" ? theme.lines[c % theme.lines.length] : theme[c];
      if (trace.type === "bar") {
        found.push({ ...trace, marker: { color: colour } });
        continue;
      }
      const dash = typeof c === "number" ? dashes[Math.floor(c / theme.lines.length) % 3] : "solid";
      trace.line = { dash, ...trace.line, color: colour };
      if (area) Object.assign(trace, { fill: "tozeroy", fillcolor: shade(colour, 0.12) });
      if (!band) {
        found.push(trace);
        continue;
      }
      const edge = { ...trace, line: { ...trace.line, color: shade(colour, 0.55) } };
      const below = { ...edge, y: trace.y.map((v) => (v === null ? null : -v)), hoverinfo: "skip", hovertemplate: null };
      found.push(below, { ...edge, fill: "tonexty", fillcolor: shade(colour, 0.12) });
    }
    return found;
  }

  // Range of an axis of errors: all errors, and the narrowest band as it usually is (at the start it may be a turn wide).
  function limits(figure, axis) {
    const shown = figure.traces.filter((trace) => trace.yaxis === axis && !hidden.has(trace.legendgroup));
    let [low, high] = [0, 0];
    for (const { y } of shown.filter((trace) => !trace.band)) {
      for (const value of y) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    const middle = (values) => values.filter((v) => v !== null).sort((a, b) => a - b)[values.length >> 1] ?? 0;
    const bands = shown.filter((trace) => trace.band).map((trace) => middle(trace.y));
    const usual = bands.length ? Math.min(...bands) : 0;
    [low, high] = [Math.min(low, -usual), Math.max(high, usual)];
    const margin = 0.08 * (high - low) || 1;
    return [low - margin, high + margin];
  }

  function layout(figure, theme) {
    const found = {
      hovermode: "x unified",
      legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom" },
      margin: { l: 64, r: 12, t: 34, b: 44 },
      dragmode: "zoom",
      ...structuredClone(figure.layout),
      font: { color: theme.text, family: "system-ui, sans-serif", size: 12 },
      paper_bgcolor: theme.back,
      plot_bgcolor: theme.back,
      hoverlabel: { bgcolor: theme.back, font: { color: theme.text } },
    };
    for (const [name, axis] of Object.entries(found)) {
      if (/^[xy]axis/.test(name)) {
        Object.assign(axis, { gridcolor: theme.grid, linecolor: theme.grid, zerolinecolor: theme.truth, automargin: true });
        if (name[0] === "x" && figure.time && range) axis.range = [...range];
        if (name === figure.errors) axis.range = limits(figure, name.replace("axis", ""));
      }
    }
    return found;
  }

  const draw = (plot) => {
    const first = !plot.dataset.drawn;
    const theme = colours();
    const figure = figures[plot.id];
    const buttons = [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]]; // none that needs a server
    const options = { responsive: true, displaylogo: false, modeBarButtons: buttons };
    plot.dataset.drawn = "1";
    Plotly.react(plot, traces(figure, theme), layout(figure, theme), options);
    if (!first) return;
    if (figure.time) plot.on("plotly_relayout", (change) => follow(plot, change));
    plot.on("plotly_restyle", () => hide(plot));
  };

  // What is hidden in one plot by its legend is hidden in all.
  function hide(source) {
    for (const trace of source.data) {
      if (trace.visible === "legendonly") hidden.add(trace.legendgroup);
      else hidden.delete(trace.legendgroup);
    }
    plots.filter((plot) => plot.dataset.drawn).forEach(draw);
  }

  let following = false; // while other plots are told, they do not tell again
  async function follow(source, change) {
    if (following) return;
    if ("xaxis.range[0]" in change) range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    else if (Array.isArray(change["xaxis.range"])) range = [...change["xaxis.range"]];
    else if (change["xaxis.autorange"]) range = null;
    else return;
    following = true;
    const update = range ? { "xaxis.range": [...range] } : { "xaxis.autorange": true };
    const others = plots.filter((plot) => plot !== source && plot.dataset.drawn && figures[plot.id].time);
    await Promise.all(others.map((plot) => Plotly.relayout(plot, structuredClone(update))));
    following = false;
  }

  const watcher = new IntersectionObserver(
    (entries) => {
      for (const { target, isIntersecting } of entries) {
        if (!isIntersecting) continue;
        watcher.unobserve(target);
        if (!target.dataset.drawn) draw(target);
      }
    },
    { rootMargin: "400px" },
  );
  for (const plot of plots) {
    plot.style.minHeight = `${figures[plot.id].layout.height}px`; // nothing jumps when it is drawn
    watcher.observe(plot);
  }
  dark.addEventListener("change", () => plots.filter((plot) => plot.dataset.drawn).forEach(draw));
  addEventListener("beforeprint", () => {
    printing = true;
    document.querySelectorAll("details").forEach((one) => (one.open = true));
    plots.forEach(draw);
  });
  addEventListener("afterprint", () => {
    printing = false;
    plots.forEach(draw);
  });
  document.querySelectorAll("nav a").forEach((link) =>
    link.addEventListener("click", () => (document.querySelector(link.hash).open = true)),
  );
  document.documentElement.dataset.ready = "1";
})();
