(async () => {
  "use strict";
  const charts = JSON.parse(document.getElementById("charts").textContent);
  const holders = charts.map((chart) => document.getElementById("chart-" + chart.name));
  const touch = matchMedia("(pointer: coarse)").matches;
  const dark = matchMedia("(prefers-color-scheme: dark)");

  async function loadPlotly() {
    const bytes = atob(document.getElementById("plotly").textContent);
    const packed = new Uint8Array(bytes.length);
    for (let index = 0; index < bytes.length; index += 1) {
      packed[index] = bytes.charCodeAt(index);
    }
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  // On a small chart marks would cover one another.
  function shrink(trace, width) {
    return width < 560 && trace.marker ? { ...trace, marker: { ...trace.marker, size: 0.7 * trace.marker.size } } : trace;
  }

  // A colour that begins with "--" is a property of the theme in force.
  function paint(value, style) {
    if (Array.isArray(value)) {
      return value;
    }
    const painted = {};
    for (const [key, item] of Object.entries(value)) {
      if (typeof item === "string" && item.startsWith("--") && key.endsWith("color")) {
        painted[key] = style.getPropertyValue(item).trim();
      } else {
        painted[key] = item !== null && typeof item === "object" ? paint(item, style) : item;
      }
    }
    return painted;
  }

  function completeLayout(layout, width, hasScale) {
    const narrow = width < 560;
    const size = narrow ? 11 : 12.5;
    const completeAxis = (axis) => ({
      gridcolor: "--grid", linecolor: "--line", zeroline: false, tickfont: { color: "--muted" }, nticks: narrow ? 6 : 0,
      ...axis,
      title: { standoff: 10, font: { size, color: "--muted" }, ...axis.title },
    });
    return {
      ...layout,
      xaxis: completeAxis(layout.xaxis),
      yaxis: completeAxis(layout.yaxis),
      autosize: true,
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size, color: "--ink" },
      // Margins that grow with the labels would have every chart drawn twice.
      margin: { l: 58, r: hasScale ? 62 : 14, t: 30, b: 46 },
      hovermode: layout.hovermode || "closest",
      hoverlabel: { bgcolor: "--surface", bordercolor: "--line", font: { color: "--ink" }, align: "left", namelength: -1 },
      showlegend: false,
      dragmode: touch ? false : layout.dragmode || "zoom",
      modebar: { bgcolor: "--surface", color: "--muted", activecolor: "--ink" },
    };
  }

  async function draw(index) {
    const style = getComputedStyle(document.documentElement);
    const { traces, layout } = charts[index];
    const width = holders[index].clientWidth;
    const hasScale = traces.some((trace) => trace.marker && trace.marker.colorbar);
    const painted = paint(completeLayout(layout, width, hasScale), style);
    const options = {
      displaylogo: false,
      displayModeBar: "hover",
      // All buttons that there are, for among the usual ones is one that sends the chart away.
      modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]],
      toImageButtonOptions: { filename: charts[index].name },
    };
    // Whoever has zoomed keeps the view when the window or the theme changes.
    painted.uirevision = "kept" + (charts[index].revision || 0);
    await Plotly.react(holders[index], traces.map((trace) => paint(shrink(trace, width), style)), painted, options);
  }

  async function drawAll() {
    for (let index = 0; index < charts.length; index += 1) {
      await draw(index);
      await new Promise((resume) => setTimeout(resume));
    }
  }

  // A click shows or hides an entry, a double click shows it alone, or all again.
  function connectLegend(index) {
    const buttons = [...holders[index].parentElement.querySelectorAll(".legend button")];
    const show = (button, shown) => {
      button.setAttribute("aria-pressed", String(shown));
      for (const trace of button.dataset.traces.split(" ")) {
        charts[index].traces[trace].visible = shown;
      }
    };
    const isShown = (button) => button.getAttribute("aria-pressed") === "true";
    for (const button of buttons) {
      button.addEventListener("click", () => {
        show(button, !isShown(button));
        draw(index);
      });
      button.addEventListener("dblclick", () => {
        const alone = buttons.every((other) => isShown(other) === (other === button));
        buttons.forEach((other) => show(other, alone || other === button));
        draw(index);
      });
    }
  }

  // The candidate on the object map: its keyframes, and the landmarks about the later one where it puts them.
  function showCandidate(place) {
    const index = charts.findIndex((chart) => chart.name === "objects");
    if (index < 0 || !place) {
      return;
    }
    const [queryX, queryY, referenceX, referenceY, x, y, yaw] = place;
    const chart = charts[index];
    const radius = chart.layout.meta.sensor_range_m;
    chart.traces = chart.traces.filter((trace) => !trace.isCandidate);
    const base = { type: "scatter", isCandidate: true, showlegend: false, hoverinfo: "skip" };
    const rings = chart.traces.filter((each) => each.mode === "markers").map((trace) => {
      const near = trace.x.map((_, row) => row).filter((row) => Math.hypot(trace.x[row] - queryX, trace.y[row] - queryY) < radius);
      const color = trace.marker.color;
      return {
        ...base,
        mode: "markers",
        name: "moved",
        visible: trace.visible,
        x: near.map((row) => x + Math.cos(yaw) * trace.x[row] - Math.sin(yaw) * trace.y[row]),
        y: near.map((row) => y + Math.sin(yaw) * trace.x[row] + Math.cos(yaw) * trace.y[row]),
        marker: { color, symbol: "circle-open", size: 17, line: { width: 2.5, color } },
      };
    });
    const ends = { x: [queryX, referenceX], y: [queryY, referenceY] };
    const color = "--closure-undecided";
    chart.traces.push(
      { ...base, ...ends, mode: "lines", name: "candidate", line: { color, width: 2.5 } },
      { ...base, ...ends, mode: "text", name: "keyframes", text: ["later", "earlier"], textposition: ["top center", "bottom center"], textfont: { color } },
      ...rings,
    );
    chart.layout.xaxis.range = [referenceX - 2 * radius, referenceX + 2 * radius];
    chart.layout.yaxis.range = [referenceY - 1.4 * radius, referenceY + 1.4 * radius];
    chart.revision = (chart.revision || 0) + 1;
    draw(index);
    holders[index].scrollIntoView({ behavior: "smooth", block: "center" });
  }

  function connectCandidates() {
    const index = charts.findIndex((chart) => chart.name === "candidates");
    if (index >= 0) {
      holders[index].on("plotly_click", (event) => showCandidate(event.points[0].customdata));
    }
  }

  try {
    await loadPlotly();
    await drawAll();
    charts.forEach((chart, index) => connectLegend(index));
    connectCandidates();
  } catch (error) {
    for (const holder of holders) {
      holder.textContent = "This browser cannot draw the charts (" + error.message + "); the tables below are complete.";
      holder.style.height = "auto";
    }
    return;
  }
  let waiting = 0;
  let width = innerWidth;
  const redraw = () => {
    cancelAnimationFrame(waiting);
    waiting = requestAnimationFrame(drawAll);
  };
  addEventListener("resize", () => {
    // A phone that hides its address bar changes only the height.
    if (innerWidth !== width) {
      width = innerWidth;
      redraw();
    }
  });
  dark.addEventListener("change", redraw);
  performance.mark("charts-drawn");
  document.documentElement.dataset.charts = "drawn";
})();
