// Draws the charts of a page with Plotly, each figure when it comes near the screen. Without
// DecompressionStream, or without scripts, the pictures stay.
async function inflate(id) {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}

// Text in lines of at most n characters, broken at spaces.
function wrap(text, n) {
  const lines = [""];
  for (const word of (text || "").split(/\s+/)) {
    const last = lines[lines.length - 1];
    if (last && last.length + word.length >= n) lines.push(word);
    else lines[lines.length - 1] = last ? `${last} ${word}` : word;
  }
  return lines.join("<br>");
}

function panel(chart) {
  const box = document.createElement("div");
  box.style.setProperty("--place", `${chart.row} / ${chart.column}`);
  const heading = document.createElement("p");
  const letter = document.createElement("b");
  letter.textContent = chart.letter;
  heading.append(letter, chart.title);
  if (chart.letter || chart.title) box.append(heading);
  const plot = document.createElement("div");
  plot.className = chart.field ? "chart field" : "chart";
  box.append(plot);
  return [box, plot];
}

function draw(figure, content) {
  const grid = document.createElement("div");
  grid.className = "charts";
  grid.style.setProperty("--columns", content.columns);
  figure.prepend(grid);
  figure.classList.add("interactive");
  const touch = matchMedia("(pointer: coarse)").matches;
  const axis = { automargin: true, zeroline: false, gridcolor: "#ddd", linecolor: "#888", ticks: "outside", exponentformat: "none", tickmode: "auto" };
  const legend = { orientation: "h", xref: "container", yref: "container", x: 0, y: 0, yanchor: "bottom", font: { size: 11 } };
  for (const chart of content.charts) {
    const [box, plot] = panel(chart);
    grid.append(box);
    const width = plot.clientWidth;
    const above = chart.layout.annotations.filter((text) => text.yref.endsWith("domain") && text.y >= 1);
    const layout = {
      ...structuredClone(chart.layout),
      height: chart.height,
      margin: { l: 8, r: 8, t: 30 + Math.max(0, ...above.map((text) => text.yshift + 12)), b: 8 },
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: "#1a1a1a" },
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      hovermode: "closest",
      dragmode: touch ? false : "zoom", // on a touch screen a drag scrolls the page
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "#aaa", activecolor: "#444" },
      legend: { ...legend, ...chart.layout.legend },
    };
    for (const name of Object.keys(layout).filter((key) => /axis/.test(key))) {
      const isX = name.startsWith("x");
      const given = layout[name];
      const settings = { ...axis, ...given };
      if (given.ticktext) {
        settings.tickmode = "array";
        const room = isX ? width / given.ticktext.length / 7 : width / 13;
        settings.ticktext = given.ticktext.map((text) => wrap(text, Math.max(room, 9)));
        const lines = Math.max(...settings.ticktext.map((text) => text.split("<br>").length));
        if (!isX) layout.height = Math.max(layout.height, 16 * lines * given.ticktext.length + 140);
      }
      const room = isX ? width - 120 : layout.height - 120;
      settings.title = { standoff: 8, font: { size: 13 }, text: wrap(given.title.text, room / 7) };
      layout[name] = settings;
    }
    Plotly.newPlot(plot, chart.data, layout, { responsive: true, displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] });
  }
}

async function start() {
  if (!("DecompressionStream" in window)) return;
  const script = document.createElement("script");
  script.text = await inflate("plotly");
  document.head.append(script);
  const charts = JSON.parse(await inflate("charts"));
  const observer = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((each) => each.isIntersecting)) {
      observer.unobserve(entry.target);
      draw(entry.target, charts[entry.target.id]);
    }
  }, { rootMargin: "600px" });
  for (const id of Object.keys(charts)) observer.observe(document.getElementById(id));
}

start();
