"use strict";
(() => {
  const content = JSON.parse(document.getElementById("content").textContent);
  const config = {responsive: true, displaylogo: false};
  // Plotly interprets some HTML in labels.
  const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const base = {
    margin: {l: 56, r: 16, t: 24, b: 48},
    font: {family: "system-ui, sans-serif", size: 13},
    hovermode: "closest",
    legend: {orientation: "h", x: 0, y: 1.02, yanchor: "bottom"},
  };
  content.charts.forEach((chart, number) => {
    Plotly.newPlot(`chart${number}`, chart.traces, {...base, ...chart.layout}, config);
  });
  if (content.map) drawMap(content.map);

  function drawMap(map) {
    const element = document.getElementById("map");
    const slider = document.getElementById("step");
    const select = document.getElementById("layer");
    const play = document.getElementById("play");
    const last = map.times.length - 1;
    const dynamic = [];  // Index of a trace, and its points at a step
    const traces = [];

    // Layers
    const narrow = element.clientWidth < 600;
    const bar = narrow ? {orientation: "h", y: 1.02, yanchor: "bottom"} : {orientation: "v"};
    map.layers.forEach((layer, number) => {
      select.add(new Option(`${layer.name} [${layer.unit}]`, number));
    });
    select.add(new Option("no layer", ""));
    const layers = map.layers.flatMap((layer, number) => {
      const visible = number === 0;
      const [zmin, zmax] = layer.limits || [undefined, undefined];
      const points = {x: layer.x, y: layer.y, z: layer.z, visible, meta: number};
      const drawn = [{
        ...points, type: "heatmap", colorscale: layer.colours, zmin, zmax, zsmooth: false,
        colorbar: {
          ...bar, thickness: 14,
          title: {text: `${plain(layer.name)} [${plain(layer.unit)}]`, side: narrow ? "top" : "right"},
        },
        hovertemplate: `%{z} ${plain(layer.unit)} at (%{x}, %{y}) m<extra></extra>`,
      }];
      if (layer.mark !== null) {
        drawn.push({
          ...points, type: "contour", showscale: false, hoverinfo: "skip",
          name: `${plain(layer.name)} = ${layer.mark}`, showlegend: true, line: {color: "#d55e00", width: 2},
          contours: {type: "constraint", operation: "=", value: layer.mark},
        });
      }
      return drawn;
    });
    traces.push(...layers);

    // Obstacles
    map.obstacles.forEach((obstacle) => {
      const timed = "from" in obstacle;
      const trace = {
        x: obstacle.x, y: obstacle.y, type: "scatter", mode: "lines", fill: "toself", hoverinfo: "skip",
        name: plain(obstacle.name), fillcolor: timed ? "rgba(239,239,239,0.5)" : "#e4e4e4",
        line: {color: "#6b6b6b", width: timed ? 2 : 1, dash: timed ? "dash" : "solid"},
      };
      if (timed) {
        const until = obstacle.until === null ? Infinity : obstacle.until;
        dynamic.push([traces.length, (step) => {
          const there = map.times[step] >= obstacle.from && map.times[step] < until;
          return there ? obstacle : {x: [null], y: [null]};
        }]);
      }
      traces.push(trace);
    });
    map.moving.forEach((one) => {
      const angles = Array.from({length: 33}, (_, k) => k * Math.PI / 16);
      dynamic.push([traces.length, (step) => ({
        x: angles.map((angle) => one.x[step] + one.radius * Math.cos(angle)),
        y: angles.map((angle) => one.y[step] + one.radius * Math.sin(angle)),
      })]);
      traces.push({
        x: [], y: [], type: "scatter", mode: "lines", fill: "toself", fillcolor: "#cfcfcf",
        line: {color: "#000", width: 1.5, dash: "dot"}, name: plain(one.name),
      });
    });

    // Paths, plans and positions
    const joined = (parts) => ({
      x: parts.flatMap((part) => [...part.x, null]),
      y: parts.flatMap((part) => [...part.y, null]),
    });
    const here = (track, step) => Math.min(step, track.x.length - 1);
    const until = (track, step) => ({
      x: track.x.slice(0, step + 1), y: track.y.slice(0, step + 1),
    });
    const planAt = (track, step) =>
      (track.plans.length === 1 ? track.plans[0] : track.plans[step]) || {x: [], y: []};
    map.groups.forEach((group) => {
      const name = plain(group.name);
      const line = {color: group.colour, width: group.tracks.length > 1 ? 1.5 : 3};
      const shared = {type: "scatter", legendgroup: name, x: [], y: []};
      if (group.tracks.some((track) => track.plans.length)) {
        dynamic.push([traces.length, (step) => joined(group.tracks.map((track) => planAt(track, step)))]);
        traces.push({
          ...shared, mode: "lines+markers", name: `${name}, plan`, line: {...line, width: 2, dash: "dash"},
          marker: {symbol: `${group.symbol}-open`, size: 7, color: group.colour},
        });
      }
      dynamic.push([traces.length, (step) => joined(group.tracks.map((track) => until(track, step)))]);
      traces.push({...shared, mode: "lines", line, name: `${name}, path`, showlegend: false});
      dynamic.push([traces.length, (step) => ({
        x: group.tracks.map((track) => track.x[here(track, step)]),
        y: group.tracks.map((track) => track.y[here(track, step)]),
      })]);
      traces.push({
        ...shared, mode: "markers", name,
        marker: {symbol: group.symbol, size: group.tracks.length > 1 ? 9 : 14, color: group.colour,
                 line: {color: "#fff", width: 1.5}},
      });
    });
    map.places.forEach((place) => {
      traces.push({
        x: [place.x], y: [place.y], type: "scatter", mode: "markers", name: plain(place.name),
        marker: {symbol: place.symbol, size: 13, color: place.colour, line: {color: "#000", width: 1.5}},
      });
    });

    const axis = {zeroline: false, constrain: "domain"};
    const layout = {
      ...base,
      legend: {orientation: "h", x: 0, y: -0.15, yanchor: "top"},
      xaxis: {...axis, title: {text: "x [m]"}},
      yaxis: {...axis, title: {text: "y [m]"}, scaleanchor: "x"},
    };
    if (map.window) {
      layout.xaxis.range = [map.window[0], map.window[2]];
      layout.yaxis.range = [map.window[1], map.window[3]];
    }
    dynamic.forEach(([index, points]) => Object.assign(traces[index], pointsOf(points, 0)));
    Plotly.newPlot(element, traces, layout, config);

    function pointsOf(points, step) {
      const {x, y} = points(step);
      return {x, y};
    }

    function show(step) {
      const drawn = dynamic.map(([, points]) => pointsOf(points, step));
      Plotly.restyle(
        element,
        {x: drawn.map((one) => one.x), y: drawn.map((one) => one.y)},
        dynamic.map(([index]) => index),
      );
      const t = map.times[step];
      const now = `t = ${t} s, step ${step} of ${last}`;
      document.getElementById("now").textContent = now;
      slider.setAttribute("aria-valuetext", now);
      const notes = map.groups.flatMap((group) => group.tracks.map((track) =>
        track.notes.length ? `${group.name}: ${track.notes[here(track, step)]}` : ""));
      document.getElementById("notes").replaceChildren(...notes.filter(Boolean).map((note) => {
        const item = document.createElement("li");
        item.textContent = note;
        return item;
      }));
      const line = {type: "line", x0: t, x1: t, y0: 0, y1: 1, yref: "paper", line: {color: "#000", width: 1.5}};
      content.charts.forEach((chart, number) => {
        if (chart.over_time) Plotly.relayout(`chart${number}`, {shapes: [line]});
      });
    }

    slider.max = last;
    slider.disabled = play.disabled = last === 0;
    slider.addEventListener("input", () => show(Number(slider.value)));
    select.addEventListener("change", () => {
      if (!layers.length) return;
      const visible = layers.map((layer) => String(layer.meta) === select.value);
      Plotly.restyle(element, {visible}, layers.map((_, index) => index));
    });
    let timer = null;
    const stop = () => {
      clearInterval(timer);
      timer = null;
      play.textContent = "Play";
      play.setAttribute("aria-pressed", "false");
    };
    play.addEventListener("click", () => {
      if (timer !== null) return stop();
      if (Number(slider.value) === last) slider.value = 0;
      play.textContent = "Pause";
      play.setAttribute("aria-pressed", "true");
      timer = setInterval(() => {
        slider.value = Number(slider.value) + 1;
        show(Number(slider.value));
        if (Number(slider.value) === last) stop();
      }, Math.max(60, Math.min(400, 20000 / (last + 1))));
    });
    show(0);
  }
})();
